//! What a file is that was given for another one.

/// The beginnings of files, what they are, and what can be done with them.
const KINDS: [(&[u8], &str); 18] = [
    (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b", "a map (pbstream)"),
    (
        b"\x89PMAPJ1\n",
        "what a `portolan map` left that was cut off: the same command with --resume goes on with it",
    ),
    (b"#ROSBAG V", "a ROS 1 bag: map it first (`portolan map`)"),
    (b"#ROSBAG ", "a ROS 1 bag: map it first (`portolan map`)"),
    (b"\x89MCAP0\r\n", "a recording (MCAP): map it first (`portolan map`)"),
    (b"SQLite f", "a database, perhaps a ROS 2 bag: map it first (`portolan map`)"),
    (b"\xd4\xc3\xb2\xa1", "a network capture: map it first (`portolan map`)"),
    (b"\x0a\x0d\x0d\x0a", "a network capture: map it first (`portolan map`)"),
    (b"ASTM-E57", "a point cloud (E57)"),
    (b"LASF", "a point cloud (LAS or LAZ)"),
    (b"ply\n", "a point cloud or mesh (PLY)"),
    (b"ply\r", "a point cloud or mesh (PLY)"),
    (b"# .PCD", "a point cloud (PCD)"),
    (b"\x89PNG", "a picture"),
    (b"%PDF", "a document (PDF)"),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (b"\x1f\x8b", "compressed (gzip): unpack it first (`gunzip`)"),
    (b"BZh", "compressed (bzip2): unpack it first (`bunzip2`)"),
];

/// What a file is that begins like this, for messages: "this is …". None for text and whatever is not known.
pub fn kind_of(start: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, kind)| *kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_by_their_beginning() {
        assert!(kind_of(b"#ROSBAG V2.0\n").is_some_and(|kind| kind.contains("ROS 1 bag")));
        assert_eq!(kind_of(b"1 2 3\n"), None);
        assert_eq!(kind_of(b""), None);
    }
}
