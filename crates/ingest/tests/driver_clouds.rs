//! Clouds as the drivers of lidars document them: names, types and units of fields, and what stamps mean.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan_geometry::{Duration, Time};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_recording::{
    FieldType, Header, MemoryRecording, Message, PointCloud2, PointField, RecordedMessage,
};
use portolan_sensor::Measurement;

const COLUMNS: usize = 180;
const RINGS: usize = 8;
const TURN: f64 = 0.1;

/// What one point is, whatever the layout.
struct Sample {
    ring: usize,
    /// Seconds since the turn began.
    since_begin: f64,
    /// When the turn began, seconds since 1970.
    begin: f64,
    position: [f32; 3],
    intensity: f32,
}

/// A field: its name, offset, type, and its value of a point.
type FieldOf = (&'static str, u32, FieldType, fn(&Sample) -> f64);

struct Driver {
    name: &'static str,
    fields: Vec<FieldOf>,
    point_step: u32,
    /// Stamp after the beginning of the turn, seconds.
    stamp: f64,
    /// Whether points come ring by ring, with what was not seen as NaN.
    organised: bool,
    has_times: bool,
}

fn x(s: &Sample) -> f64 {
    f64::from(s.position[0])
}
fn y(s: &Sample) -> f64 {
    f64::from(s.position[1])
}
fn z(s: &Sample) -> f64 {
    f64::from(s.position[2])
}
fn intensity(s: &Sample) -> f64 {
    f64::from(s.intensity)
}
fn ring(s: &Sample) -> f64 {
    s.ring as f64
}

fn drivers() -> Vec<Driver> {
    use FieldType::{Float32, Float64, Uint8, Uint16, Uint32};
    let xyz = |more: Vec<FieldOf>| -> Vec<FieldOf> {
        let mut fields: Vec<FieldOf> = vec![("x", 0, Float32, x), ("y", 4, Float32, y), ("z", 8, Float32, z)];
        fields.extend(more);
        fields
    };
    let driver = |name, fields, point_step, stamp| Driver {
        name,
        fields: xyz(fields),
        point_step,
        stamp,
        organised: false,
        has_times: true,
    };
    vec![
        // velodyne_pointcloud, `PointXYZIRT`: seconds since the stamp, which is the first packet's …
        driver(
            "Velodyne, first packet",
            vec![
                ("intensity", 12, Float32, intensity),
                ("ring", 16, Uint16, ring),
                ("time", 18, Float32, |s| s.since_begin),
            ],
            22,
            0.0,
        ),
        // … or, as the driver does on its own, the last packet's.
        driver(
            "Velodyne, last packet",
            vec![
                ("intensity", 12, Float32, intensity),
                ("ring", 16, Uint16, ring),
                ("time", 18, Float32, |s| s.since_begin - TURN),
            ],
            22,
            TURN,
        ),
        // ouster-ros, `Point`: nanoseconds since the stamp; (0, 0, 0) where nothing came back.
        driver(
            "Ouster",
            vec![
                ("intensity", 16, Float32, intensity),
                ("t", 20, Uint32, |s| 1e9 * s.since_begin),
                ("reflectivity", 24, Uint16, |_| 7.0),
                ("ring", 26, Uint16, ring),
                ("ambient", 28, Uint16, |_| 3.0),
                ("range", 32, Uint32, |_| 5000.0),
            ],
            48,
            0.0,
        ),
        // HesaiLidar_ROS: seconds since 1970.
        driver(
            "Hesai",
            vec![
                ("intensity", 16, Float32, intensity),
                ("timestamp", 24, Float64, |s| s.begin + s.since_begin),
                ("ring", 32, Uint16, ring),
            ],
            40,
            0.0,
        ),
        // livox_ros_driver2 with `xfer_format: 0`: nanoseconds since 1970.
        driver(
            "Livox",
            vec![
                ("intensity", 12, Float32, intensity),
                ("tag", 16, Uint8, |_| 16.0),
                ("line", 17, Uint8, ring),
                ("timestamp", 18, Float64, |s| 1e9 * (s.begin + s.since_begin)),
            ],
            26,
            0.0,
        ),
        // rslidar_sdk, `POINT_TYPE=XYZIRT`: seconds since 1970, organised, stamped with the last point.
        Driver {
            organised: true,
            ..driver(
                "RoboSense",
                vec![
                    ("intensity", 16, Float32, intensity),
                    ("ring", 20, Uint16, ring),
                    ("timestamp", 24, Float64, |s| {
                        if s.position[0].is_nan() { 0.0 } else { s.begin + s.since_begin }
                    }),
                ],
                32,
                TURN,
            )
        },
        // Without times, stamped at the end, as `PointXYZI` has it.
        Driver {
            has_times: false,
            ..driver("without times", vec![("intensity", 16, Float32, intensity)], 32, TURN)
        },
    ]
}

/// Two walls and more, all at distances that determine the direction.
fn sample(begin: f64, column: usize, ring: usize, no_return: bool) -> Sample {
    let share = column as f64 / COLUMNS as f64;
    let azimuth = 1.0 - share * std::f64::consts::TAU;
    let elevation = (2.0 * ring as f64 - 7.0).to_radians();
    // No two clouds are the same.
    let range = 6.0 + azimuth.sin() + 1e-5 * (1e3 * begin + column as f64).sin();
    let position = [range * azimuth.cos(), range * azimuth.sin(), range * elevation.tan()].map(|v| v as f32);
    let position = if no_return { [f32::NAN; 3] } else { position };
    Sample { ring, since_begin: share * TURN, begin, position, intensity: (column % 100) as f32 }
}

fn cloud(driver: &Driver, begin: f64) -> PointCloud2 {
    let no_return = |column: usize, ring: usize| driver.organised && (column + ring) % 9 == 4;
    let by_column = |i: usize| (i / RINGS, i % RINGS);
    let by_ring = |i: usize| (i % COLUMNS, i / COLUMNS);
    let mut data = Vec::new();
    for i in 0..COLUMNS * RINGS {
        let (column, ring) = if driver.organised { by_ring(i) } else { by_column(i) };
        let sample = sample(begin, column, ring, no_return(column, ring));
        let mut point = vec![0xaa; driver.point_step as usize];
        for (_, offset, field_type, value) in &driver.fields {
            let value = value(&sample);
            let bytes = match field_type {
                FieldType::Uint8 => vec![value as u8],
                FieldType::Uint16 => (value as u16).to_le_bytes().to_vec(),
                FieldType::Uint32 => (value.round() as u32).to_le_bytes().to_vec(),
                FieldType::Float32 => (value as f32).to_le_bytes().to_vec(),
                _ => value.to_le_bytes().to_vec(),
            };
            point[*offset as usize..*offset as usize + bytes.len()].copy_from_slice(&bytes);
        }
        data.extend(point);
    }
    let (width, height) = if driver.organised { (COLUMNS, RINGS) } else { (COLUMNS * RINGS, 1) };
    let field = |(name, offset, field_type, _): &FieldOf| PointField {
        name: (*name).to_owned(),
        offset: *offset,
        field_type: Some(*field_type),
        count: 1,
    };
    PointCloud2 {
        header: Header { stamp: Time::from_unix_seconds(begin + driver.stamp), frame_id: "lidar".into() },
        height: height as u32,
        width: width as u32,
        fields: driver.fields.iter().map(field).collect(),
        is_bigendian: false,
        point_step: driver.point_step,
        row_step: driver.point_step * width as u32,
        data,
        is_dense: !driver.organised,
    }
}

#[test]
fn clouds_of_all_drivers_have_the_times_of_their_points() {
    for driver in drivers() {
        let begin = |i: usize| 1_700_000_000.0 + TURN * i as f64;
        let recorded = |i: usize| RecordedMessage {
            topic: "/points".into(),
            log_time: Time::from_unix_seconds(begin(i) + TURN) + Duration::from_seconds(0.002),
            message: Message::PointCloud2(cloud(&driver, begin(i))),
        };
        let recording = MemoryRecording::new((0..30).map(recorded).collect());
        let options = IngestOptions { with_intensities: true, ..IngestOptions::default() };
        let mut ingestion = Ingestion::new(&recording, &options).unwrap();
        assert_eq!(ingestion.plan().range[0].point_time.is_some(), driver.has_times, "{}", driver.name);
        let mut sweeps = 0;
        while let Some((_, measurement)) = ingestion.next_measurement().unwrap() {
            let Measurement::Range(sweep) = measurement else { panic!("{}", driver.name) };
            for (point, intensity) in sweep.points_in_tracking.iter().zip(&sweep.intensities) {
                let azimuth = point.position.y.atan2(point.position.x);
                let share =
                    f64::from(1.0 - azimuth).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
                let column = (share * COLUMNS as f64).round() as usize % COLUMNS;
                let expected = begin(sweeps) + column as f64 / COLUMNS as f64 * TURN;
                let time = sweep.time.unix_seconds() + f64::from(point.time);
                assert!(
                    (time - expected).abs() < 2e-6,
                    "{}: column {column}, {}",
                    driver.name,
                    time - expected
                );
                assert_eq!(*intensity, (column % 100) as f32, "{}", driver.name);
            }
            let seen = if driver.organised { COLUMNS * RINGS * 8 / 9 } else { COLUMNS * RINGS };
            assert_eq!(sweep.points_in_tracking.len(), seen, "{}", driver.name);
            sweeps += 1;
        }
        assert_eq!(sweeps, 30, "{}", driver.name);
        assert!(ingestion.issues().iter().all(|repair| !repair.lost_data()), "{}", driver.name);
    }
}
