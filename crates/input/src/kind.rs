//! Recognises the type of a file that was given in place of another, for error messages.

/// Magic bytes of binary formats, with a description and advice.
const KINDS: [(&[u8], &str); 18] = [
    (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b", "a map (pbstream)"),
    (
        b"\x89PMAPJ1\n",
        "the journal of an interrupted `portolan map`: the same command with --resume continues it",
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

/// Description of the file type that begins with these bytes, for messages: "this is …". None for text and unknown
/// formats.
pub fn kind_of(start: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, kind)| *kind)
}

/// Unambiguous beginnings of text formats, and of further binary formats, with a description.
const TEXTS: [(&[u8], &str); 12] = [
    (b"<", "XML: a robot description (URDF) is given with --urdf"),
    (b"{", "JSON"),
    (b"--", "a Lua file: a configuration is given with --config"),
    (b"include ", "a Lua file: a configuration is given with --config"),
    (b"return ", "a Lua file: a configuration is given with --config"),
    (b"VERTEX_", "a pose graph (g2o)"),
    (b"EDGE_", "a pose graph (g2o)"),
    (b"image:", "the description of an image map (YAML), from which the map cannot be restored"),
    (b"P5\n", "a picture"),
    (b"P6\n", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
    (&[0; 8], "a file that begins with zeros: damaged, or only partly copied"),
];

/// As [`kind_of`], and also recognises text formats and empty files. For callers that can use none of these formats.
pub fn unwanted_kind_of(start: &[u8]) -> Option<&'static str> {
    let text = start.trim_ascii_start();
    let of_text = || TEXTS.iter().find(|(begin, _)| text.starts_with(begin)).map(|(_, kind)| *kind);
    kind_of(start).or_else(of_text).or(start.is_empty().then_some("an empty file"))
}

/// Maximum number of characters that are quoted.
const QUOTED: usize = 40;

/// Excerpt of a file for a message: its first characters in quotation marks, terminal control characters escaped.
pub fn quoted(text: &str) -> String {
    let rest = if text.chars().nth(QUOTED).is_some() { " …" } else { "" };
    let shown: String = text.chars().take(QUOTED).flat_map(char::escape_debug).collect();
    format!("\"{}\"{rest}", shown.replace("\\\"", "\"").replace("\\'", "'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_kinds_are_recognised_by_their_beginning() {
        assert!(kind_of(b"#ROSBAG V2.0\n").is_some_and(|kind| kind.contains("ROS 1 bag")));
        assert_eq!(kind_of(b"1 2 3\n"), None);
        assert_eq!(kind_of(b""), None);
    }

    #[test]
    fn unwanted_file_kinds_are_recognised_by_their_beginning() {
        let kind = |start: &[u8]| unwanted_kind_of(start).unwrap_or_default();
        assert!(kind(b"<?xml version").contains("URDF") && kind(b"\n  <robot>").contains("URDF"));
        assert!(kind(b"-- Copyright").contains("--config") && kind(b"include \"map").contains("--config"));
        assert_eq!(
            (kind(b""), kind(b"VERTEX_S"), kind(b"1 2 3")),
            ("an empty file", "a pose graph (g2o)", "")
        );
        assert!(kind(&[0; 16]).contains("zeros") && kind(b"#ROSBAG V2.0\n").contains("ROS 1 bag"));
    }

    #[test]
    fn quotes_are_short_and_control_no_terminal() {
        assert_eq!(quoted("it's \"so\""), "\"it's \"so\"\"");
        assert_eq!(quoted("\u{1b}[2J"), "\"\\u{1b}[2J\"");
        assert_eq!(quoted(&"é".repeat(41)), format!("\"{}\" …", "é".repeat(40)));
    }
}
