//! Files as other programs write them, uos folders, and damaged files.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use std::path::Path;

use portolan_geometry::Vector3;
use portolan_issue::Issue;
use portolan_pointcloud::{
    Attributes, CloudError, Encoding, PointCloud, UosFolder, WriteOptions, create, open,
};
use proptest::prelude::*;

fn read(path: &Path) -> Result<(PointCloud, Vec<Issue>), CloudError> {
    let mut reader = open(path)?;
    let mut all = PointCloud::new(reader.attributes());
    let mut batch = PointCloud::default();
    while reader.next_batch(&mut batch)? {
        all.extend(&batch);
    }
    Ok((all, reader.issues()))
}

fn read_bytes(bytes: &[u8], name: &str) -> Result<(PointCloud, Vec<Issue>), CloudError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read(&path)
}

#[test]
fn ply_of_other_programs() {
    let header = "ply\r\nformat ascii 1.0\r\nelement camera 1\r\nproperty list uchar int views\r\nelement vertex 2\r\n\
        property float y\r\nproperty double x\r\nproperty float z\r\nproperty float scalar_Intensity\r\n\
        property uchar red\r\nproperty uchar green\r\nproperty uchar blue\r\nelement face 1\r\n\
        property list uchar int vertex_indices\r\nend_header\r\n3 1 2 3\r\n2 1 3 0.5 10 20 30\r\n5 4 6 1 1 2 3\r\n3 0 0 1\r\n";
    let (cloud, issues) = read_bytes(header.as_bytes(), "a.ply").unwrap();
    assert!(issues.is_empty() && cloud.len() == 2);
    assert_eq!(
        (cloud.position(0), cloud.intensity(0), cloud.color(0)),
        ([1.0, 2.0, 3.0], Some(0.5), Some([10, 20, 30]))
    );
    // Big endian, with a list before the vertices.
    let mut bytes =
        b"ply\nformat binary_big_endian 1.0\nelement tag 2\nproperty list uchar short v\nelement vertex 1\n\
        property float x\nproperty float y\nproperty float z\nproperty ushort red\nproperty ushort green\n\
        property ushort blue\nend_header\n"
            .to_vec();
    bytes.extend([2, 0, 1, 0, 2, 0]);
    [1.5_f32, -2.0, 8.0].iter().for_each(|v| bytes.extend(v.to_be_bytes()));
    [65_535_u16, 257, 0].iter().for_each(|v| bytes.extend(v.to_be_bytes()));
    let (cloud, _) = read_bytes(&bytes, "b.ply").unwrap();
    assert_eq!((cloud.position(0), cloud.color(0)), ([1.5, -2.0, 8.0], Some([255, 1, 0])));
    for wrong in [
        "ply\nend_header\n",
        "ply\nformat ascii 1.0\nelement vertex x\nend_header\n",
        "ply\nformat ascii 1.0\n",
    ] {
        assert!(read_bytes(wrong.as_bytes(), "c.ply").is_err(), "{wrong}");
    }
}

#[test]
fn pcd_of_other_programs() {
    let text = "# .PCD v.7 - Point Cloud Data file format\nVERSION .7\nFIELDS x y z rgb _ intensity\nSIZE 4 4 4 4 1 4\n\
        TYPE F F F F U F\nCOUNT 1 1 1 1 4 1\nWIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ascii\n\
        1 2 3 4.2108e+06 0 0 0 0 7\nnan nan nan 0 0 0 0 0 0\n4 5 6 0 1 2 3 4 8\n";
    let (cloud, issues) = read_bytes(text.as_bytes(), "a.pcd").unwrap();
    assert_eq!((cloud.len(), cloud.intensity(1)), (2, Some(8.0)));
    let color = 4.2108e+06_f32.to_bits();
    assert_eq!(cloud.color(0), Some([(color >> 16) as u8, (color >> 8) as u8, color as u8]));
    let counts: Vec<(u64, bool)> = issues.iter().map(|r| (r.count, r.lost_data())).collect();
    assert_eq!(counts, [(1, false), (1, true)]);
    assert!(
        read_bytes(b"VERSION .7\nFIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 1\nDATA binary\n", "b.pcd").is_err()
    );
}

#[test]
fn text_has_named_columns_or_the_usual_ones() {
    for (text, position, intensity, color) in [
        ("1 2 3\n4 5 6\n", [1.0, 2.0, 3.0], None, None),
        ("2\n1 2 3 -7 10 20 30\n4 5 6 1 1 1 1\n", [1.0, 2.0, 3.0], Some(-7.0), Some([10, 20, 30])),
        ("//X,Y,Z,R,G,B\n1;2;3;9;8;7\n4;5;6;0;0;0\n", [1.0, 2.0, 3.0], None, Some([9, 8, 7])),
        ("\"t\",\"x\",\"y\",\"z\",\"intensity\"\n5.5,1,2,3,4\n1,4,5,6,0\n", [1.0, 2.0, 3.0], Some(4.0), None),
    ] {
        let (cloud, issues) = read_bytes(text.as_bytes(), "a.txt").unwrap();
        assert_eq!((cloud.len(), cloud.position(0)), (2, position), "{text}");
        assert_eq!((cloud.intensity(0), cloud.color(0)), (intensity, color), "{text}");
        assert!(issues.is_empty());
    }
    let (cloud, issues) = read_bytes(b"1 2 3\nhello\n4 5 6\n7 8\n", "a.xyz").unwrap();
    assert_eq!((cloud.len(), issues.len()), (2, 2));
    assert!(read_bytes(b"hello world\n", "a.xyz").err().unwrap().to_string().contains("PLY"));
    assert!(read_bytes(b"", "a.xyz").is_err());
}

#[test]
fn uos_folders_are_placed_by_their_poses() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("scan000.3d", "header 1\n100 200 300\n0 0 100\n");
    write("scan000.pose", "0 0 0\n0 0 0\n");
    // Yaw is about y; 100 cm to the right.
    write("scan001.3d", "0 0 100 0.5\n");
    write("scan001.pose", "100 0 0\n0 90 0\n");
    write("scan002.3d", "0 0 100\n");
    write("scan002.pose", "0 0 0\n0 0 0\n");
    write("scan002.frames", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 2\n1 0 0 0 0 1 0 0 0 0 1 0 0 50 0 1 3\n");
    let uos = UosFolder::open(folder.path()).unwrap();
    assert_eq!(uos.scans.iter().map(|s| s.number).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!((uos.scans[2].frames.len(), uos.scans[2].frames[1].kind), (2, 3));
    assert!((uos.scans[2].world_from_scan().translation.vector - Vector3::new(0.0, 0.0, 0.5)).norm() < 1e-12);
    let (cloud, issues) = read(folder.path()).unwrap();
    assert!(issues.is_empty());
    // Ahead is x, right is −y, up is z; a left-handed turn about up of +90° turns ahead to the right.
    let expected = [[3.0, -1.0, 2.0], [1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [1.0, 0.0, 0.5]];
    for (i, expected) in expected.into_iter().enumerate() {
        let position = cloud.position(i);
        assert!((0..3).all(|k| (position[k] - expected[k]).abs() < 1e-9), "{i}: {position:?}");
    }
    write("scan001.pose", "1 2 three\n");
    assert!(read(folder.path()).err().unwrap().to_string().contains("scan001.pose"));
    assert!(open(tempfile::tempdir().unwrap().path()).is_err());
}

fn sample(name: &str, encoding: Encoding) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let attributes = Attributes { intensity: true, time: true, color: true };
    let mut cloud = PointCloud::new(attributes);
    for i in 0..60 {
        let t = f64::from(i);
        cloud.push([t, -t * 0.1, t.sin()], t as f32, t, [i as u8; 3]);
    }
    let options = WriteOptions { encoding, ..WriteOptions::default() };
    let mut writer = create(&path, attributes, &options).unwrap();
    writer.write(&cloud).unwrap();
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn cut_files_say_what_is_missing() {
    for (name, encoding) in [
        ("x.ply", Encoding::Binary),
        ("x.ply", Encoding::Ascii),
        ("x.pcd", Encoding::Binary),
        ("x.pcd", Encoding::Ascii),
        ("x.las", Encoding::Binary),
        ("x.xyz", Encoding::Binary),
    ] {
        let bytes = sample(name, encoding);
        let (cloud, issues) = read_bytes(&bytes[..bytes.len() - 300], name).unwrap();
        assert!(cloud.len() < 60 && cloud.len() > 20, "{name} {}", cloud.len());
        assert!(name == "x.xyz" || issues.iter().any(|r| r.lost_data()), "{name}");
    }
    let bytes = sample("x.pcd", Encoding::Compressed);
    assert!(read_bytes(&bytes[..bytes.len() - 10], "x.pcd").is_err());
}

/// Memory is not asked for as much as a damaged number says.
#[test]
fn laz_that_promises_more_than_it_can_have_is_refused() {
    let bytes = sample("x.laz", Encoding::Binary);
    let offset = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let table = u64::from_le_bytes(bytes[offset..offset + 8].try_into().unwrap()) as usize;
    let mut chunks = bytes.clone();
    chunks[table + 4..table + 8].copy_from_slice(&u32::MAX.to_le_bytes());
    // The place of the table at the end, as writers leave it that cannot go back.
    let mut at_the_end = chunks.clone();
    at_the_end[offset..offset + 8].fill(0xff);
    at_the_end.extend((table as u64).to_le_bytes());
    // A record behind the points that would fill any memory.
    let mut record = bytes.clone();
    record[235..243].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
    record[243..247].copy_from_slice(&1_u32.to_le_bytes());
    record.extend([0; 60]);
    record[bytes.len() + 20..bytes.len() + 28].copy_from_slice(&(1_u64 << 46).to_le_bytes());
    for damaged in [chunks, at_the_end, record] {
        let error = read_bytes(&damaged, "x.laz").err().unwrap();
        assert!(matches!(&error, CloudError::Damaged { .. }), "{error}");
        assert!(error.to_string().contains("promises") || error.to_string().contains("longer"), "{error}");
    }
    // Both ways are good where the number is.
    let mut at_the_end = bytes.clone();
    at_the_end[offset..offset + 8].fill(0xff);
    at_the_end.extend((table as u64).to_le_bytes());
    for good in [bytes, at_the_end] {
        assert_eq!(read_bytes(&good, "x.laz").unwrap().0.len(), 60);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn damaged_files_never_panic(
        kind in 0..9_usize,
        cut in 0..6000_usize,
        flips in prop::collection::vec((0..6000_usize, any::<u8>()), 0..5),
    ) {
        let (name, encoding) = [
            ("x.ply", Encoding::Binary),
            ("x.ply", Encoding::Ascii),
            ("x.pcd", Encoding::Binary),
            ("x.pcd", Encoding::Ascii),
            ("x.pcd", Encoding::Compressed),
            ("x.xyz", Encoding::Binary),
            ("x.las", Encoding::Binary),
            ("x.laz", Encoding::Binary),
            ("x.e57", Encoding::Binary),
        ][kind];
        let mut bytes = sample(name, encoding);
        for (at, value) in flips {
            let at = at % bytes.len();
            bytes[at] ^= value;
        }
        bytes.truncate(cut.max(1));
        let _ = read_bytes(&bytes, name);
    }
}

/// CRC-32C, as the pages of E57 files have it.
fn crc32c(bytes: &[u8]) -> u32 {
    let step = |crc: u32| if crc & 1 == 1 { (crc >> 1) ^ 0x82f6_3b78 } else { crc >> 1 };
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc)))
}

/// An E57 file that holds nothing but this XML.
fn e57_of(xml: &str) -> Vec<u8> {
    let mut content = b"ASTM-E57".to_vec();
    [1_u32, 0].iter().for_each(|version| content.extend(version.to_le_bytes()));
    let pages = (48 + xml.len()).div_ceil(1020) as u64;
    let numbers = [1024 * pages, 48, xml.len() as u64, 1024];
    numbers.iter().for_each(|number| content.extend(number.to_le_bytes()));
    content.extend(xml.as_bytes());
    content.resize(1020 * pages as usize, 0);
    content.chunks(1020).flat_map(|page| [page, &crc32c(page).to_be_bytes()].concat()).collect()
}

#[test]
fn xml_that_would_take_minutes_is_refused() {
    let attributes: String = (0..100_000).map(|i| format!(" a{i}=''")).collect();
    let error = read_bytes(&e57_of(&format!("<e57Root{attributes}/>")), "a.e57").unwrap_err();
    assert!(error.to_string().contains("more than 256 attributes"), "{error}");
    let error = read_bytes(&e57_of(&"<a>".repeat(100_000)), "a.e57").unwrap_err();
    assert!(error.to_string().contains("nested deeper than 128"), "{error}");
    let error = read_bytes(&e57_of("<e57Root/>"), "a.e57").unwrap_err();
    assert!(!error.to_string().contains("XML has"), "{error}");
}

#[test]
fn lines_without_end_are_named_or_counted() {
    let long = "7".repeat(100_000);
    let (cloud, repairs) = read_bytes(format!("1 2 3\n{long} 2 3\n4 5 6\n").as_bytes(), "a.xyz").unwrap();
    assert_eq!(cloud.len(), 2);
    assert!(
        repairs.iter().any(|r| r.lost_data() && r.to_string().contains("longer than 64 KiB")),
        "{repairs:?}"
    );
    let header =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let ply = format!("{header}end_header\n1 2 3\n{long} 5 6\n7 8 9\n");
    let error = read_bytes(ply.as_bytes(), "a.ply").unwrap_err();
    assert!(error.to_string().contains("line 9 is longer than 64 KiB"), "{error}");
}

#[test]
fn elements_that_are_promised_and_not_there_take_no_time() {
    let ply = "ply\nformat binary_little_endian 1.0\nelement tag 18446744073709551615\nproperty list uchar int v\n\
        element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let (cloud, repairs) = read_bytes(ply.as_bytes(), "a.ply").unwrap();
    assert!(cloud.is_empty() && repairs.iter().any(|r| r.lost_data()), "{repairs:?}");
}

#[cfg(unix)]
#[test]
fn formats_read_in_one_pass_may_be_pipes() {
    let folder = tempfile::tempdir().unwrap();
    let attributes = Attributes { intensity: true, time: true, color: true };
    let mut cloud = PointCloud::new(attributes);
    (0..5000).for_each(|i| cloud.push([f64::from(i), 0.5, -1.0], 7.0, 1.0, [1, 2, 3]));
    for (name, encoding) in [
        ("a.ply", Encoding::Binary),
        ("b.ply", Encoding::Ascii),
        ("c.pcd", Encoding::Binary),
        ("d.pcd", Encoding::Compressed),
        ("e.xyz", Encoding::Ascii),
        ("f.las", Encoding::Binary),
    ] {
        let path = folder.path().join(name);
        let options = WriteOptions { encoding, ..WriteOptions::default() };
        let mut writer = create(&path, attributes, &options).unwrap();
        writer.write(&cloud).unwrap();
        writer.finish().unwrap();
        let from_file = read(&path).unwrap();
        let fifo = folder.path().join(format!("{name}.fifo"));
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let bytes = std::fs::read(&path).unwrap();
        let writing = fifo.clone();
        // Whoever cannot use a pipe closes it early.
        let writer = std::thread::spawn(move || std::fs::write(writing, bytes));
        let from_pipe = read(&fifo);
        if name.ends_with("las") {
            let error = from_pipe.unwrap_err().to_string();
            assert!(error.contains("save it as a file first"), "{error}");
        } else {
            assert_eq!(from_pipe.unwrap(), from_file, "{name}");
            writer.join().unwrap().unwrap();
        }
    }
}

#[test]
fn zeroed_blocks_of_a_compressed_cloud_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    let mut cloud = PointCloud::new(Attributes::default());
    let at = |i: i32| f64::from(i);
    (0..40_000).for_each(|i| cloud.push([500.0 + (at(i) * 0.7).sin(), at(i) * 0.01, 90.0], 0.0, 0.0, [0; 3]));
    let mut writer = create(&path, cloud.attributes(), &WriteOptions::default()).unwrap();
    writer.write(&cloud).unwrap();
    writer.finish().unwrap();
    let sound = std::fs::read(&path).unwrap();
    assert!(read(&path).unwrap().1.is_empty());
    let middle = sound.len() / 2;
    let mut damaged = sound.clone();
    damaged[middle..middle + 2000].fill(0);
    match read_bytes(&damaged, "b.laz") {
        Ok((_, repairs)) => assert!(repairs.iter().any(|repair| repair.lost_data()), "{repairs:?}"),
        Err(error) => assert!(error.to_string().contains("damaged"), "{error}"),
    }
}
