//! `map_builder`: dimension, threads, pose graph; and the server around it.

use super::PoseGraphOptions;
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Options common to all trajectories of a map.
    MapBuilderOptions {
        /// Map in 2D. Exactly one of this and `use_trajectory_builder_3d` must be on.
        use_trajectory_builder_2d: bool = false, "", Bounds::ANY;
        /// Map in 3D. Exactly one of this and `use_trajectory_builder_2d` must be on.
        use_trajectory_builder_3d: bool = false, "", Bounds::ANY;
        /// Threads that search constraints and optimise while local SLAM goes on; never more than there are
        /// cores. `--threads` overrides it; without either all cores are used. Results do not depend on it.
        num_background_threads: usize = 4, "threads", Bounds::within(1.0, 1024.0);
        /// Global SLAM.
        pose_graph: PoseGraphOptions = PoseGraphOptions::default();
        /// Bring the measurements of each trajectory into time order separately, instead of in one queue for
        /// all, in which a silent sensor of one trajectory delays the others. Turn it on for several live
        /// robots.
        collate_by_trajectory: bool = false, "", Bounds::ANY;
    }
}

options! {
    /// A map builder that serves several robots over the network. Portolan reads and checks such files and
    /// has no server itself: only `map_builder` of this table has an effect.
    MapBuilderServerOptions {
        /// The map builder that is served.
        map_builder: MapBuilderOptions =
            MapBuilderOptions { collate_by_trajectory: true, ..MapBuilderOptions::default() };
        /// Threads that handle events. Raise it with the number of clients.
        num_event_threads: usize = 4, "threads", Bounds::within(1.0, 1024.0);
        /// Threads of the network layer. Raise it with the number of clients.
        num_grpc_threads: usize = 4, "threads", Bounds::within(1.0, 1024.0);
        /// Address and port to listen on.
        server_address: String = "0.0.0.0:50051".to_owned(), "address", Bounds::ANY;
        /// Address and port of the server to send local results to; empty: none.
        uplink_server_address: String = String::new(), "address", Bounds::ANY;
        /// Measurements sent upwards at once. Raise it on slow links.
        upload_batch_size: usize = 100, "messages", Bounds::at_least(1.0);
        /// Encrypt the uplink.
        enable_ssl_encryption: bool = false, "", Bounds::ANY;
        /// Authenticate at the uplink with a Google account.
        enable_google_auth: bool = false, "", Bounds::ANY;
    }
}
