use super::*;

/// Position, intensity and time.
type Sample = ([f64; 3], f32, f64);

fn points(count: usize) -> impl Iterator<Item = Sample> {
    let mut random = portolan_numeric::Lcg64::new(12_345);
    let mut random = move || (random.bits() >> 40) as f64 / f64::from(1 << 24);
    (0..count).map(move |i| {
        let position = [20.0 * random() - 10.0, 4.0 * random() - 2.0, random() - 0.5];
        (position, random() as f32, 1.7e9 + 0.001 * i as f64)
    })
}

fn thinned(memory: usize) -> Vec<VoxelPoint> {
    let mut thinner = VoxelThinner::with_memory(0.25, memory).unwrap();
    for (position, intensity, time) in points(50_000) {
        thinner.add(position, intensity, time).unwrap();
    }
    thinner.add([f64::NAN, 0.0, 0.0], 0.0, 0.0).unwrap();
    let mut cloud = thinner.finish().unwrap();
    assert_eq!(cloud.not_finite(), 1);
    let mut found = Vec::new();
    for _ in 0..2 {
        found.clear();
        cloud
            .for_each(&mut |point| {
                found.push(*point);
                Ok(())
            })
            .unwrap();
    }
    found
}

#[test]
fn voxels_have_the_means_of_their_points() {
    let found = thinned(usize::MAX);
    let mut expected: std::collections::BTreeMap<[i32; 3], Vec<Sample>> = Default::default();
    for point in points(50_000) {
        expected.entry(point.0.map(|v| (v / 0.25).floor() as i32)).or_default().push(point);
    }
    assert_eq!(found.len(), expected.len());
    for (voxel, all) in found.iter().zip(expected.values()) {
        let mean = |f: &dyn Fn(&Sample) -> f64| all.iter().map(f).sum::<f64>() / all.len() as f64;
        assert_eq!(voxel.count, all.len() as u64);
        for axis in 0..3 {
            assert!((voxel.position[axis] - mean(&|p| p.0[axis])).abs() < 1e-9);
        }
        assert!((f64::from(voxel.intensity) - mean(&|p| f64::from(p.1))).abs() < 1e-6);
        assert!((voxel.time - mean(&|p| p.2)).abs() < 1e-5);
    }
}

/// The size of memory changes voxels only by rounding, and the same size always gives the same bytes.
#[test]
fn memory_does_not_change_the_cloud() {
    let all = thinned(usize::MAX);
    for memory in [700, 2000] {
        let runs = thinned(memory);
        assert_eq!(runs, thinned(memory));
        assert_eq!(runs.len(), all.len());
        for (a, b) in runs.iter().zip(&all) {
            assert_eq!(a.count, b.count);
            assert!((0..3).all(|i| (a.position[i] - b.position[i]).abs() < 1e-12), "{a:?} {b:?}");
        }
    }
}

/// Runs are written to the given folder; if that fails, the error names it.
#[test]
fn runs_wait_in_the_folder_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let spilled = |folder: &Path| {
        let mut thinner = VoxelThinner::with_memory(0.25, 700).unwrap().in_folder(folder);
        points(50_000).try_for_each(|(position, intensity, time)| thinner.add(position, intensity, time))
    };
    spilled(folder.path()).unwrap();
    let nowhere = folder.path().join("nowhere");
    let error = spilled(&nowhere).unwrap_err().to_string();
    assert!(error.contains(nowhere.to_str().unwrap()), "{error}");
}

#[test]
fn sizes_that_make_no_sense_are_refused() {
    for size in [0.0, -1.0, f64::NAN, 1e9] {
        assert!(matches!(VoxelThinner::new(size), Err(CloudError::VoxelSize(_))));
    }
    let mut nothing = VoxelThinner::new(0.1).unwrap().finish().unwrap();
    nothing.for_each(&mut |_| unreachable!("there are no voxels")).unwrap();
}
