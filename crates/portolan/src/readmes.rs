//! Includes the examples in the READMEs of all crates as documentation tests of one crate. Compiling one
//! program for all of them takes as long as one for a single crate.

/// A module with each README as its documentation.
macro_rules! readmes {
    ($($name:ident $path:literal,)*) => {
        $(#[doc = include_str!($path)] mod $name {})*
    };
}

readmes! {
    atomic_file "../../atomic_file/README.md",
    bunzip2 "../../bunzip2/README.md",
    clocks "../../clocks/README.md",
    config "../../config/README.md",
    diagnose "../../diagnose/README.md",
    evaluation "../../evaluation/README.md",
    export "../../export/README.md",
    geometry "../../geometry/README.md",
    grids "../../grids/README.md",
    ingest "../../ingest/README.md",
    input "../../input/README.md",
    issue "../../issue/README.md",
    lidar_odometry "../../lidar_odometry/README.md",
    lidar_packets "../../lidar_packets/README.md",
    local_slam "../../local_slam/README.md",
    localization "../../localization/README.md",
    mapfile "../../mapfile/README.md",
    mapping "../../mapping/README.md",
    matching "../../matching/README.md",
    motion "../../motion/README.md",
    numeric "../../numeric/README.md",
    optimization "../../optimization/README.md",
    pbstream "../../pbstream/README.md",
    recall "../../recall/README.md",
    recording "../../recording/README.md",
    refinement "../../refinement/README.md",
    registration "../../registration/README.md",
    reprojection "../../reprojection/README.md",
    ros_messages "../../ros_messages/README.md",
    sensor "../../sensor/README.md",
    solver "../../solver/README.md",
    spatial "../../spatial/README.md",
    spool "../../spool/README.md",
    submaps "../../submaps/README.md",
    unfinished "../../unfinished/README.md",
    worlds "../../worlds/README.md",
}
