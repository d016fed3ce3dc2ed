use super::*;
use crate::SensorKind;
use proptest::prelude::*;

const SECOND: i64 = 10_000_000;

fn sensor(name: &str) -> SensorId {
    SensorId::new(SensorKind::Range, name)
}

/// A collator whose payloads are the times themselves, and everything that it has output.
struct Bench {
    collator: Collator<i64>,
    out: Vec<(u32, i64)>,
}

impl Bench {
    fn new(options: CollatorOptions, trajectories: &[(u32, &[&str])]) -> Self {
        let mut collator = Collator::new(options);
        for (id, sensors) in trajectories {
            collator.add_trajectory(*id, sensors.iter().map(|s| sensor(s)));
        }
        Self { collator, out: Vec::new() }
    }

    /// Cartographer's ordering, without limits.
    fn reference(trajectories: &[(u32, &[&str])]) -> Self {
        Self::new(CollatorOptions { by_trajectory: false, wait_limit: None }, trajectories)
    }

    fn add(&mut self, trajectory: u32, name: &str, ticks: i64) -> usize {
        self.collator.add(trajectory, &sensor(name), Time::from_ticks(ticks), ticks);
        self.drain()
    }

    fn finish(&mut self, trajectory: u32) -> usize {
        self.collator.finish_trajectory(trajectory);
        self.drain()
    }

    fn flush(&mut self) -> usize {
        self.collator.flush();
        self.drain()
    }

    fn drain(&mut self) -> usize {
        while let Some(item) = self.collator.pop() {
            assert_eq!(item.time.ticks(), item.payload);
            self.out.push((item.trajectory_id, item.payload));
        }
        self.out.len()
    }

    fn times(&self) -> Vec<i64> {
        self.out.iter().map(|o| o.1).collect()
    }

    fn counts(&self, trajectory: u32, name: &str) -> SensorCounts {
        self.collator.counts()[&(trajectory, sensor(name))]
    }
}

const THREE: &[(u32, &[&str])] = &[(1, &["a", "b"]), (2, &["b"])];

#[test]
fn queues_are_merged_in_order() {
    let mut bench = Bench::reference(THREE);
    for time in [0, 4, 5, 6] {
        assert_eq!(bench.add(1, "a", time), 0);
    }
    assert_eq!((bench.add(1, "b", 0), bench.add(1, "b", 1)), (0, 0));
    assert_eq!((bench.add(2, "b", 0), bench.add(2, "b", 2)), (3, 4));
    assert_eq!(bench.add(1, "b", 3), 5);
    bench.add(1, "b", 7);
    bench.add(2, "b", 8);
    assert_eq!(bench.flush(), 11);
    assert!(bench.times().is_sorted());
}

#[test]
fn finished_queues_are_not_waited_for() {
    let mut bench = Bench::reference(&[(1, &["a"]), (2, &["b"]), (3, &["c"])]);
    for time in [1, 2, 3] {
        bench.add(1, "a", time);
    }
    assert_eq!((bench.finish(1), bench.finish(2), bench.finish(3)), (0, 0, 3));
    assert_eq!(bench.times(), [1, 2, 3]);
}

#[test]
fn each_trajectory_starts_when_all_its_sensors_have() {
    let mut bench = Bench::reference(THREE);
    for time in 0..4 {
        bench.add(1, "a", time);
    }
    bench.add(1, "b", 2);
    assert_eq!(bench.add(2, "b", 4), 2);
    assert_eq!(bench.counts(1, "a").before_start, 2);
    // Trajectory 1 ends: its last datum is output, and then those of the other trajectory.
    assert_eq!(bench.finish(1), 4);
    assert_eq!(bench.finish(2), 4);
    assert_eq!(bench.times(), [2, 2, 3, 4]);
}

#[test]
fn the_last_datum_before_the_common_start_is_kept() {
    let mut bench = Bench::reference(&[(0, &["imu", "scan"])]);
    for time in [10, 20, 30, 40] {
        bench.add(0, "imu", time);
    }
    bench.add(0, "scan", 35);
    bench.flush();
    assert_eq!(bench.times(), [30, 35, 40]);
}

#[test]
fn one_trajectory_names_the_sensor_that_is_waited_for() {
    let names = ["horizontal", "imu", "odometry", "vertical"];
    let mut bench = Bench::reference(&[(0, &names)]);
    for name in names {
        bench.add(0, name, 0);
    }
    for (name, time) in [("vertical", 100), ("imu", 300), ("horizontal", 200), ("odometry", 400)] {
        bench.add(0, name, time);
    }
    bench.add(0, "horizontal", 600);
    assert_eq!(bench.add(0, "vertical", 500), 7);
    assert_eq!(bench.times(), [0, 0, 0, 0, 100, 200, 300]);
    assert_eq!(bench.collator.blocking(), Some(&(0, sensor("imu"))));
    bench.finish(0);
    assert_eq!(bench.flush(), 10);
    assert!(bench.times().is_sorted());
}

#[test]
fn trajectories_share_a_queue_or_not() {
    let trajectories: &[(u32, &[&str])] = &[(8, &["a", "imu"]), (5, &["a", "imu"])];
    let data = [
        (8, "a", 1),
        (8, "imu", 2),
        (5, "a", 1),
        (5, "imu", 3),
        (8, "a", 4),
        (8, "imu", 4),
        (5, "a", 5),
        (5, "imu", 5),
    ];
    let mut shared = Bench::reference(trajectories);
    for (trajectory, name, time) in &data[..3] {
        assert_eq!(shared.add(*trajectory, name, *time), 0);
    }
    assert_eq!(shared.collator.blocking(), Some(&(5, sensor("imu"))));
    for (trajectory, name, time) in &data[3..] {
        shared.add(*trajectory, name, *time);
    }
    assert_eq!(shared.flush(), 8);
    assert!(shared.times().is_sorted());

    let mut alone = Bench::new(CollatorOptions { by_trajectory: true, wait_limit: None }, trajectories);
    let received: Vec<usize> = data.iter().map(|(t, name, time)| alone.add(*t, name, *time)).collect();
    assert_eq!(received, [0, 0, 0, 0, 2, 3, 5, 6]);
    assert!(alone.collator.blocking().is_none());
    assert_eq!(alone.flush(), 8);
}

#[test]
fn a_silent_sensor_delays_but_does_not_block() {
    let mut bench = Bench::new(CollatorOptions::default(), &[(0, &["imu", "scan"])]);
    for tenth in 0..100 {
        bench.add(0, "imu", tenth * SECOND / 10);
    }
    // 9.9 s of data, of which the last three seconds are still held back.
    assert_eq!(bench.out.len(), 69);
    let reports = bench.collator.take_reports();
    assert_eq!((reports.len(), &*reports[0].sensor_id.id, reports[0].last_time), (1, "scan", None));
    // The scanner sends again, with a scan that is a second old: it is sorted in.
    bench.add(0, "scan", 89 * SECOND / 10);
    assert_eq!(bench.out.len(), 90 + 1);
    assert!(bench.times().is_sorted());
    // It is silent again, which is counted but not reported again.
    for tenth in 100..140 {
        bench.add(0, "imu", tenth * SECOND / 10);
    }
    assert!(bench.collator.take_reports().is_empty());
    assert_eq!(bench.counts(0, "scan").stalls, 2);
    bench.add(0, "scan", 90 * SECOND / 10);
    assert_eq!(bench.counts(0, "scan").late, 1);
    bench.flush();
    assert_eq!((bench.out.len(), bench.times().is_sorted()), (141, true));
}

#[test]
fn a_stopped_clock_fills_a_queue_up_to_its_limit() {
    let options = CollatorOptions {
        wait_limit: Some(WaitLimit { queued_items: 50, ..Default::default() }),
        ..Default::default()
    };
    let mut bench = Bench::new(options, &[(0, &["imu", "scan"])]);
    for _ in 0..1000 {
        bench.add(0, "imu", 7);
    }
    assert_eq!(bench.out.len(), 950);
}

#[test]
fn a_sensor_with_one_message_does_not_delay_the_start() {
    let mut bench = Bench::new(CollatorOptions::default(), &[(0, &["a", "b"])]);
    bench.add(0, "a", 0);
    for second in 1..20 {
        bench.add(0, "b", second * SECOND);
    }
    assert_eq!(bench.times()[..3], [0, SECOND, 2 * SECOND]);
    assert_eq!(bench.out.len(), 1 + 15);
}

#[test]
fn disorder_is_counted() {
    let mut bench = Bench::new(CollatorOptions::default(), &[(0, &["a", "b"])]);
    for time in [10, 30, 20, 30] {
        bench.add(0, "a", time);
    }
    bench.add(0, "c", 5);
    bench.add(1, "a", 5);
    assert_eq!((bench.counts(0, "a").out_of_order, bench.collator.unknown().len()), (1, 2));
    bench.flush();
    assert_eq!(bench.times(), [10, 30, 30]);
    bench.add(0, "a", 40);
    assert_eq!(bench.collator.unknown()[&(0, sensor("a"))], 1);
}

#[test]
fn one_stamp_from_the_future_does_not_silence_a_sensor() {
    let mut bench = Bench::new(CollatorOptions::default(), &[(0, &["a", "b"])]);
    for second in 0..10 {
        bench.add(0, "a", if second == 5 { 1000 * SECOND } else { second * SECOND });
        bench.add(0, "b", second * SECOND);
    }
    bench.flush();
    assert_eq!((bench.out.len(), bench.times().is_sorted()), (19, true));
    assert_eq!((bench.counts(0, "a").out_of_order, bench.counts(0, "a").dispatched), (1, 9));
}

#[test]
fn a_second_recording_may_be_older() {
    let mut bench = Bench::new(CollatorOptions::default(), &[(0, &["a"])]);
    bench.add(0, "a", 100 * SECOND);
    bench.finish(0);
    bench.collator.add_trajectory(1, [sensor("a")]);
    bench.add(1, "a", 5 * SECOND);
    bench.flush();
    assert_eq!(bench.out, [(0, 100 * SECOND), (1, 5 * SECOND)]);
}

proptest! {
    #[test]
    fn output_is_ordered_and_all_losses_are_counted(
        data in prop::collection::vec((0..2u32, 0..3usize, -20..100i64), 0..300),
        by_trajectory: bool,
        limit in prop::option::of((0..30i64, 0..20usize)),
    ) {
        let wait_limit =
            limit.map(|(ticks, queued_items)| WaitLimit { data_time: Duration::from_ticks(ticks), queued_items });
        let sensors: &[&str] = &["a", "b", "c"];
        let trajectories: &[(u32, &[&str])] = &[(0, sensors), (1, sensors)];
        let mut bench = Bench::new(CollatorOptions { by_trajectory, wait_limit }, trajectories);
        for (i, (trajectory, name, jitter)) in data.iter().enumerate() {
            bench.add(*trajectory, sensors[*name], 3 * i as i64 + jitter);
        }
        bench.flush();
        for trajectory in 0..2 {
            let times: Vec<i64> = bench.out.iter().filter(|o| o.0 == trajectory).map(|o| o.1).collect();
            prop_assert!(times.is_sorted());
        }
        let counts = bench.collator.counts();
        let received: u64 = counts.values().map(|c| c.received).sum();
        prop_assert_eq!(received, data.len() as u64);
        for c in counts.values() {
            prop_assert_eq!(c.received, c.dispatched + c.before_start + c.out_of_order + c.late);
        }
        let dispatched: u64 = counts.values().map(|c| c.dispatched).sum();
        prop_assert_eq!(dispatched, bench.out.len() as u64);
    }
}
