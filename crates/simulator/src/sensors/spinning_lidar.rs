//! A lidar with many beams that spins or has another scan pattern: each beam is fired from the pose of the
//! moving lidar at its time.

use std::sync::Arc;

use portolan_geometry::{Rigid3, Time, Vector3};
use portolan_recording::{FieldType, Header, PointCloud2, PointField};

use super::beam_table::{BeamTable, ScanPattern};
use crate::motion::{Motion, MotionState};
use portolan_worlds::Random;
use portolan_worlds::three_d::{Echo, Ray3, SolidWorld};

/// Bytes of a point: x, y, z, intensity, ring and time, as Velodyne's driver lays them out.
const POINT_BYTES: usize = 22;
/// Minimum light of a return at the maximum range, as a fraction of that of a white surface there; at
/// shorter range less suffices, with the square of the range.
const FAINTEST: f64 = 0.04;

/// A spinning lidar.
#[derive(Clone, Debug, PartialEq)]
pub struct SpinningLidarOptions {
    /// Topic of its `sensor_msgs/PointCloud2`. Default `/points2`.
    pub topic: String,
    /// Its frame. Default `lidar`.
    pub frame: String,
    /// Pose of the lidar on the platform.
    pub base_from_lidar: Rigid3,
    /// Its beams. Default those of a VLP-16.
    pub beams: BeamTable,
    /// Revolutions per second, or sweeps per second of other scan patterns. Default 10.
    pub rate: f64,
    /// Whether the head spins clockwise, seen from above. Default yes.
    pub clockwise: bool,
    /// Seconds after the start at which its first sweep begins. Default 0.
    pub phase: f64,
    /// Minimum range that is measured, metres. Default 0.4.
    pub range_min: f64,
    /// Standard deviation of ranges, metres. Default 0.02.
    pub range_noise: f64,
    /// Resolution of ranges, metres; 0 for none. Default 0.002.
    pub range_resolution: f64,
    /// Probability that a beam has no return although it hits a surface. Default 0.004.
    pub drop_out: f64,
    /// Whether dark, slanted and far surfaces may return too little light to be detected. Default yes.
    pub faint_returns_lost: bool,
    /// Whether panes give a return or are passed at random; otherwise they are always passed. Default yes.
    pub glass_returns: bool,
    /// Whether every beam is fired at its own time; otherwise the whole sweep is measured at its stamp.
    /// Default yes.
    pub motion_distortion: bool,
    /// Whether points have the time of their measurement (`time`, seconds after the stamp). Default yes.
    pub point_times: bool,
}

impl Default for SpinningLidarOptions {
    fn default() -> Self {
        Self {
            topic: "/points2".to_owned(),
            frame: "lidar".to_owned(),
            base_from_lidar: Rigid3::identity(),
            beams: BeamTable::vlp16(),
            rate: 10.0,
            clockwise: true,
            phase: 0.0,
            range_min: 0.4,
            range_noise: 0.02,
            range_resolution: 0.002,
            drop_out: 0.004,
            faint_returns_lost: true,
            glass_returns: true,
            motion_distortion: true,
            point_times: true,
        }
    }
}

impl SpinningLidarOptions {
    /// The same lidar without any error: exact ranges, no drop-outs, no returns from panes.
    pub fn without_noise(self) -> Self {
        Self {
            range_noise: 0.0,
            range_resolution: 0.0,
            drop_out: 0.0,
            faint_returns_lost: false,
            glass_returns: false,
            ..self
        }
    }
}

/// A beam at azimuth 0.
#[derive(Clone, Copy, Debug)]
struct Beam {
    direction: Vector3,
    delay: f64,
    ring: u16,
}

/// A spinning lidar, ready to measure.
#[derive(Clone, Debug)]
pub(crate) struct SpinningLidar {
    pub options: SpinningLidarOptions,
    pub topic: Arc<str>,
    frame: Arc<str>,
    beams: Vec<Beam>,
    seed: u64,
}

/// Pose and velocities of a lidar during one firing.
struct Firing {
    map_from_lidar: Rigid3,
    velocity_in_map: Vector3,
    angular_velocity_in_map: Vector3,
}

impl SpinningLidar {
    pub fn new(options: SpinningLidarOptions, seed: u64) -> Self {
        let table = &options.beams;
        let spin = Self::spin(&options);
        // Rings are numbered from below.
        let mut order: Vec<usize> = (0..table.elevations.len()).collect();
        order.sort_by(|a, b| table.elevations[*a].total_cmp(&table.elevations[*b]));
        let mut rings = vec![0; order.len()];
        order.iter().enumerate().for_each(|(ring, beam)| rings[*beam] = ring as u16);
        let beams = (0..table.elevations.len()).map(|i| {
            let delay = if options.motion_distortion { table.delays[i] } else { 0.0 };
            let (sine, cosine) = libm::sincos(table.elevations[i]);
            // The head goes on rotating while the beams of a firing go out.
            let (left, ahead) = libm::sincos(table.azimuth_offsets[i] + spin * table.delays[i]);
            let direction = Vector3::new(cosine * ahead, cosine * left, sine);
            Beam { direction, delay, ring: rings[i] }
        });
        Self {
            beams: beams.collect(),
            topic: options.topic.as_str().into(),
            frame: options.frame.as_str().into(),
            options,
            seed,
        }
    }

    /// Angular velocity of the head, rad/s, positive counter-clockwise; 0 for other scan patterns.
    fn spin(options: &SpinningLidarOptions) -> f64 {
        let turn = match options.beams.pattern {
            ScanPattern::Spinning => std::f64::consts::TAU * options.rate,
            ScanPattern::Rosette { .. } | ScanPattern::Wave { .. } => 0.0,
        };
        if options.clockwise { -turn } else { turn }
    }

    /// Duration of a sweep, seconds.
    pub fn sweep_time(&self) -> f64 {
        1.0 / self.options.rate
    }

    /// Maximum number of points of a sweep.
    pub fn points_per_sweep(&self) -> usize {
        self.beams.len() * self.options.beams.columns
    }

    /// Approximate size of a message, bytes.
    pub fn message_bytes(&self) -> u64 {
        (self.points_per_sweep() * POINT_BYTES) as u64
    }

    fn firing(&self, motion: &dyn Motion, time: f64) -> Firing {
        let MotionState { map_from_base, velocity_in_map, angular_velocity_in_base, .. } = motion.state(time);
        let arm = map_from_base.rotation * self.options.base_from_lidar.translation.vector;
        let angular_velocity_in_map = map_from_base.rotation * angular_velocity_in_base;
        Firing {
            map_from_lidar: map_from_base * self.options.base_from_lidar,
            velocity_in_map: velocity_in_map + angular_velocity_in_map.cross(&arm),
            angular_velocity_in_map,
        }
    }

    /// Sweep number `index`, which begins `start` seconds after the start of the motion, at the stamp.
    pub fn sweep(
        &self,
        world: &SolidWorld,
        motion: &dyn Motion,
        (index, start, stamp): (u64, f64, Time),
    ) -> PointCloud2 {
        let o = &self.options;
        let mut random = Random::new(self.seed, &o.topic, index);
        let (columns, sweep_time) = (o.beams.columns, self.sweep_time());
        let place = self.firing(motion, start).map_from_lidar.translation.vector;
        let moment = world.moment(&place, o.beams.range_max, start, sweep_time);
        let mut data = Vec::with_capacity(self.points_per_sweep() * POINT_BYTES);
        let direction_of_turn = if o.clockwise { -1.0 } else { 1.0 };
        for column in 0..columns {
            let share = column as f64 / columns as f64;
            let since_stamp = share * sweep_time;
            let fired = if o.motion_distortion { start + since_stamp } else { start };
            let firing = self.firing(motion, fired);
            let rotation = firing.map_from_lidar.rotation.to_rotation_matrix();
            let [azimuth, elevation] = o.beams.pattern.axis(share, start + since_stamp - o.phase);
            let (sine, cosine) = libm::sincos(direction_of_turn * azimuth);
            let (up, ahead) = libm::sincos(elevation);
            for beam in &self.beams {
                let d = beam.direction;
                let d = Vector3::new(ahead * d.x - up * d.z, d.y, up * d.x + ahead * d.z);
                let in_lidar = Vector3::new(cosine * d.x - sine * d.y, sine * d.x + cosine * d.y, d.z);
                // Between the beams of a firing the velocities are constant: the error by an acceleration
                // of 10 m/s² over 55 µs is 15 nm.
                let straight = rotation * in_lidar;
                let direction = straight + firing.angular_velocity_in_map.cross(&straight) * beam.delay;
                let origin = firing.map_from_lidar.translation.vector + firing.velocity_in_map * beam.delay;
                let ray = Ray3 { origin, direction };
                let chance = o.glass_returns.then_some(&mut random);
                let Some(echo) = world.echo(&ray, o.beams.range_max, (&moment, share), chance) else {
                    continue;
                };
                if let Some((range, intensity)) = self.measure(&echo, &mut random) {
                    let time = (since_stamp + if o.motion_distortion { beam.delay } else { 0.0 }) as f32;
                    let time = if o.point_times { time } else { 0.0 };
                    push_point(&mut data, &(in_lidar * range), intensity, beam.ring, time);
                }
            }
        }
        cloud(Header { stamp, frame_id: Arc::clone(&self.frame) }, data, o.point_times)
    }

    /// Range and intensity as measured; none without a return.
    fn measure(&self, echo: &Echo, random: &mut Random) -> Option<(f64, f32)> {
        let o = &self.options;
        if o.drop_out > 0.0 && random.chance(o.drop_out) {
            return None;
        }
        let light = echo.albedo * echo.cosine;
        let share = echo.range / o.beams.range_max;
        if o.faint_returns_lost && light < FAINTEST * share * share {
            return None;
        }
        let noise = if o.range_noise > 0.0 { o.range_noise * random.gaussian() } else { 0.0 };
        let mut range = echo.range + noise;
        if o.range_resolution > 0.0 {
            range = (range / o.range_resolution).round() * o.range_resolution;
        }
        let intensity = (255.0 * echo.albedo * (0.3 + 0.7 * echo.cosine)).round();
        (range >= o.range_min).then_some((range, intensity as f32))
    }
}

fn push_point(data: &mut Vec<u8>, point: &Vector3, intensity: f32, ring: u16, time: f32) {
    let mut bytes = [0_u8; POINT_BYTES];
    let values = [point.x as f32, point.y as f32, point.z as f32, intensity];
    for (slot, value) in bytes.chunks_exact_mut(4).zip(values) {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    bytes[16..18].copy_from_slice(&ring.to_le_bytes());
    bytes[18..22].copy_from_slice(&time.to_le_bytes());
    data.extend_from_slice(&bytes);
}

fn cloud(header: Header, data: Vec<u8>, point_times: bool) -> PointCloud2 {
    let field = |name: &str, offset: u32, field_type: FieldType| PointField {
        name: name.to_owned(),
        offset,
        field_type: Some(field_type),
        count: 1,
    };
    let mut fields = vec![
        field("x", 0, FieldType::Float32),
        field("y", 4, FieldType::Float32),
        field("z", 8, FieldType::Float32),
        field("intensity", 12, FieldType::Float32),
        field("ring", 16, FieldType::Uint16),
    ];
    if point_times {
        fields.push(field("time", 18, FieldType::Float32));
    }
    let width = (data.len() / POINT_BYTES) as u32;
    PointCloud2 {
        header,
        height: 1,
        width,
        fields,
        is_bigendian: false,
        point_step: POINT_BYTES as u32,
        row_step: data.len() as u32,
        data,
        is_dense: true,
    }
}
