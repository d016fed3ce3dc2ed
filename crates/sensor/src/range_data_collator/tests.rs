use super::*;
use proptest::prelude::*;

const SAMPLES: usize = 10;

/// Ten points from one tick to another; z is the fraction of that interval.
fn message(from: i64, to: i64, with_intensities: bool) -> TimedPointCloudData {
    let share = |k: usize| k as f32 / (SAMPLES - 1) as f32;
    let span = Duration::from_ticks(to - from).seconds() as f32;
    TimedPointCloudData {
        time: Time::from_ticks(to),
        origin_in_tracking: Point3f::new(0.0, 1.0, 2.0),
        points_in_tracking: (0..SAMPLES)
            .map(|k| TimedPoint {
                position: Point3f::new(0.0, 0.0, share(k)),
                time: -(1.0 - share(k)) * span,
            })
            .collect(),
        intensities: (0..if with_intensities { SAMPLES } else { 0 }).map(share).collect(),
    }
}

fn collator(sensors: &[&str]) -> RangeDataCollator {
    RangeDataCollator::new(sensors.iter().map(|s| Arc::from(*s)))
}

/// Tick of the oldest point.
fn oldest(ranges: &SynchronizedRanges) -> i64 {
    let first = f64::from(ranges.points[0].point.time);
    (ranges.time + Duration::from_seconds(first)).ticks()
}

fn is_sorted(ranges: &SynchronizedRanges) -> bool {
    ranges.points.is_sorted_by(|a, b| a.point.time <= b.point.time)
        && ranges.points.last().is_none_or(|p| p.point.time <= 0.0)
}

#[test]
fn one_sensor() {
    let mut collator = collator(&["a"]);
    let first = collator.add("a", message(200, 300, false)).unwrap();
    assert_eq!((first.time.ticks(), first.origins.len(), first.points.len()), (300, 1, SAMPLES));
    assert!(is_sorted(&first));
    let second = collator.add("a", message(300, 500, false)).unwrap();
    assert_eq!((second.time.ticks(), second.points.len()), (500, SAMPLES));
    assert!((oldest(&second) - 300).abs() <= 2);
    let third = collator.add("a", message(-1000, 510, false)).unwrap();
    assert_eq!((third.time.ticks(), third.points.len(), third.points[0].point.time), (510, 1, 0.0));
    assert_eq!(collator.counts().earlier_points, 9);
}

#[test]
fn an_empty_message_passes() {
    let mut collator = collator(&["a"]);
    let empty = TimedPointCloudData { points_in_tracking: Vec::new(), ..message(0, 300, false) };
    let first = collator.add("a", empty).unwrap();
    assert_eq!((first.time.ticks(), first.origins.len(), first.points.len()), (300, 1, 0));
    let second = collator.add("a", message(300, 500, false)).unwrap();
    assert_eq!((second.time.ticks(), second.points.len()), (500, SAMPLES));
}

#[test]
fn two_sensors() {
    let mut collator = collator(&["a", "b"]);
    assert!(collator.add("a", message(200, 300, false)).is_none());
    let first = collator.add("b", message(-1000, 310, false)).unwrap();
    assert_eq!((first.time.ticks(), first.origins.len(), first.points.len()), (300, 2, 2 * SAMPLES - 1));
    assert!(is_sorted(&first) && (oldest(&first) + 1000).abs() <= 2);
    assert_eq!(first.points.last().unwrap().point.time, 0.0);
    let second = collator.add("a", message(300, 500, false)).unwrap();
    assert_eq!((second.time.ticks(), second.origins.len(), second.points.len()), (310, 2, 2));
    let third = collator.add("a", message(600, 700, false)).unwrap();
    assert_eq!((third.time.ticks(), third.origins.len()), (500, 1));
    let total = [&first, &second, &third].map(|r| r.points.len()).iter().sum::<usize>();
    assert_eq!(total, 3 * SAMPLES);
    assert!(is_sorted(&second) && is_sorted(&third));
}

#[test]
fn three_sensors_with_and_without_intensities() {
    for with_intensities in [false, true] {
        let mut collator = collator(&["a", "b", "c"]);
        assert!(collator.add("a", message(200, 300, with_intensities)).is_none());
        assert!(collator.add("b", message(200, 300, with_intensities)).is_none());
        let first = collator.add("c", message(-1000, 300, with_intensities)).unwrap();
        assert_eq!((first.points.len(), first.origins.len()), (3 * SAMPLES, 3));
        assert_eq!(first.intensities.len(), if with_intensities { 3 * SAMPLES } else { 0 });
        let same = |(p, i): (&SynchronizedPoint, &f32)| (p.point.position.z - i).abs() < 1e-6;
        assert!(first.points.iter().zip(&first.intensities).all(same));
    }
}

#[test]
fn three_sensors_of_which_one_repeats() {
    let mut collator = collator(&["a", "b", "c"]);
    let mut total = 0;
    assert!(collator.add("a", message(200, 300, true)).is_none());
    assert!(collator.add("b", message(200, 300, false)).is_none());
    // Only the first point of the long message and the ten points of each of the others are in the span.
    let first = collator.add("c", message(250, 1000, true)).unwrap();
    total += first.points.len();
    assert!(collator.add("a", message(310, 320, true)).is_none());
    let second = collator.add("a", message(320, 900, true)).unwrap();
    assert_eq!(second.time.ticks(), 320);
    total += second.points.len();
    let third = collator.add("a", message(2000, 3000, true)).unwrap();
    total += third.points.len();
    assert!(is_sorted(&first) && is_sorted(&second) && is_sorted(&third));
    // Everything but the points later than the last span.
    assert_eq!(total, 5 * SAMPLES - 2);
    // Sensor b has no intensities: zeros are used instead.
    assert_eq!(first.intensities.len(), first.points.len());
    let zeros = first.points.iter().zip(&first.intensities).filter(|(p, _)| p.origin_index == 1);
    assert!(zeros.map(|(_, i)| *i).all(|i| i == 0.0));
}

#[test]
fn points_in_no_order_are_put_in_order() {
    let mut collator = collator(&["a"]);
    let mut scrambled = message(200, 300, true);
    scrambled.points_in_tracking.swap(0, 9);
    scrambled.intensities.swap(0, 9);
    scrambled.points_in_tracking[4].time = f32::NAN;
    let ranges = collator.add("a", scrambled).unwrap();
    assert!(is_sorted(&ranges) && ranges.points.len() == 9);
    assert!(ranges.points.iter().zip(&ranges.intensities).all(|(p, i)| p.point.position.z == *i));
    let counts = collator.counts();
    assert_eq!((counts.points_without_time, counts.reordered_messages), (1, 1));
}

#[test]
fn unexpected_and_older_messages_are_counted() {
    let mut collator = collator(&["a"]);
    assert!(collator.add("b", message(0, 1, false)).is_none());
    collator.add("a", message(200, 300, false));
    let old = collator.add("a", message(100, 250, false)).unwrap();
    assert_eq!((old.time.ticks(), old.points.len()), (300, 0));
    assert_eq!((collator.counts().unexpected_messages, collator.counts().earlier_points), (1, 10));
}

proptest! {
    #[test]
    fn spans_are_sorted_and_all_losses_are_counted(
        messages in prop::collection::vec((0..3usize, 0..400i64, 0..300i64, any::<bool>()), 0..40),
    ) {
        let sensors = ["a", "b", "c"];
        let mut collator = collator(&sensors);
        let (mut points, mut last) = (0, Time::MIN);
        for (i, (sensor, lead, span, with_intensities)) in messages.iter().enumerate() {
            let to = 100 * i as i64 + lead;
            let Some(ranges) = collator.add(sensors[*sensor], message(to - span, to, *with_intensities)) else {
                continue;
            };
            prop_assert!(is_sorted(&ranges) && ranges.time >= last);
            prop_assert!(ranges.points.iter().all(|p| p.origin_index < ranges.origins.len()));
            prop_assert!(ranges.intensities.is_empty() || ranges.intensities.len() == ranges.points.len());
            last = ranges.time;
            points += ranges.points.len();
        }
        let held: usize = collator.sensors.values().flatten().map(|p| p.rest().len()).sum();
        prop_assert_eq!(points + held + collator.counts().earlier_points as usize, SAMPLES * messages.len());
    }
}
