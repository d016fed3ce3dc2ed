//! Writes maps for ROS: a grey image and a description (`formats.md §7`).

use std::borrow::Cow;
use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};

use portolan_atomic_file::{AtomicFile, WriteError, write_atomically};
use portolan_numeric::format_general;

use crate::paint::PaintedMap;

/// How the description refers to its image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageName {
    /// The path as given, with its folders, as in the format. Programs resolve it relative to the
    /// description, so the image is found only for paths without folders and for absolute paths.
    #[default]
    AsOpened,
    /// The file name alone; it stays valid when both files are moved together.
    Beside,
}

/// Writes `<stem>.pgm` and `<stem>.yaml`; returns their names.
///
/// # Errors
/// If a file cannot be written, or the name of the image is not Unicode.
pub fn write_ros_map(
    stem: &Path,
    map: &PaintedMap,
    image_name: ImageName,
) -> Result<(PathBuf, PathBuf), WriteError> {
    let (image, description) = (with_ending(stem, ".pgm"), with_ending(stem, ".yaml"));
    let name = match image_name {
        ImageName::AsOpened => image.as_os_str(),
        ImageName::Beside => image.file_name().unwrap_or(image.as_os_str()),
    };
    let name = name.to_str().ok_or_else(|| WriteError {
        path: image.clone(),
        source: std::io::Error::other(
            "the description of a map for ROS can only name files whose names are Unicode (UTF-8)",
        ),
    })?;
    let text = ros_map_yaml(name, map.resolution, map.lower_left());
    write_pgm(&image, map)?;
    write_atomically(&description, text.as_bytes())?;
    Ok((image, description))
}

/// Appends an ending; unlike an extension it does not replace the part of the name after a dot.
fn with_ending(stem: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(stem);
    name.push(ending);
    PathBuf::from(name)
}

/// Writes the image of a ROS map: occupied is black, free is white.
///
/// # Errors
/// If the file cannot be written.
pub fn write_pgm(path: &Path, map: &PaintedMap) -> Result<(), WriteError> {
    let mut file = AtomicFile::create(path)?;
    let grey: Vec<u8> = map.grey().collect();
    let written = file
        .write_all(pgm_header(map.resolution, map.width, map.height).as_bytes())
        .and_then(|()| file.write_all(&grey));
    match written {
        Ok(()) => file.commit(),
        Err(source) => Err(file.error(source)),
    }
}

fn pgm_header(resolution: f64, width: usize, height: usize) -> String {
    format!("P5\n# Cartographer map; {} m/pixel\n{width} {height}\n255\n", format_general(resolution, 6))
}

/// The description of a ROS map. `lower_left` is the position of the image's lower left corner, metres.
pub fn ros_map_yaml(image: &str, resolution: f64, lower_left: [f64; 2]) -> String {
    // Cartographer's six digits would round to centimetres beyond a kilometre, and to metres in UTM.
    let digits = |v: f64| if v.abs() < 1000.0 { 6 } else { 12 };
    let [x, y] = lower_left.map(|v| format_general(v, digits(v)));
    format!(
        "image: {}\nresolution: {}\norigin: [{x}, {y}, 0.0]\nnegate: 0\noccupied_thresh: \
         0.65\nfree_thresh: 0.196\n",
        yaml_text(image),
        format_general(resolution, 6)
    )
}

/// A text as a YAML value: plain if no part of it has a special meaning, as in usual names, otherwise quoted.
fn yaml_text(text: &str) -> Cow<'_, str> {
    let is_plain = |c: char| c.is_alphanumeric() || "/._+-() ".contains(c);
    let begins = text.chars().next().is_some_and(|c| c.is_alphanumeric() || "/._".contains(c));
    if begins && text.chars().all(is_plain) && !text.ends_with(' ') {
        return Cow::Borrowed(text);
    }
    let quoted = |c: char| match c {
        '"' | '\\' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04x}", u32::from(c)),
        c => c.to_string(),
    };
    Cow::Owned(format!("\"{}\"", text.chars().map(quoted).collect::<String>()))
}

/// Whether a text is the output of [`ros_map_yaml`] for an image of this name in any folder: a description
/// that was written with the image and not edited by hand since.
pub fn is_ros_map_yaml_of(text: &str, image: &Path) -> bool {
    let lines: Vec<&str> = text.lines().collect();
    let [name, resolution, origin, rest @ ..] = lines.as_slice() else { return false };
    let image = image.file_name().and_then(|name| name.to_str());
    let is_named = |written: &str| {
        let beside = Path::new(written).file_name().and_then(|name| name.to_str());
        image.is_some_and(|image| beside == Some(image) || written == yaml_text(image))
    };
    name.strip_prefix("image: ").is_some_and(is_named)
        && resolution.starts_with("resolution: ")
        && origin.starts_with("origin: [")
        && *rest == ["negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.196"]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_descriptions_are_recognised() {
        let text = ros_map_yaml("maps/house.pgm", 0.05, [-1.0, 2.0]);
        assert!(is_ros_map_yaml_of(&text, Path::new("elsewhere/house.pgm")));
        assert!(!is_ros_map_yaml_of(&text, Path::new("hall.pgm")));
        assert!(!is_ros_map_yaml_of(&text.replace("0.65", "0.7"), Path::new("house.pgm")));
        assert!(!is_ros_map_yaml_of("", Path::new("house.pgm")));
    }

    #[test]
    fn names_with_a_meaning_in_yaml_are_quoted() {
        let line = |name| ros_map_yaml(name, 0.05, [0.0, 0.0]).lines().next().map(str::to_owned);
        assert_eq!(line("the house (2).pgm").as_deref(), Some("image: the house (2).pgm"));
        for (name, expected) in [
            ("a: b #1.pgm", r#"image: "a: b #1.pgm""#),
            (r#"the "house".pgm"#, r#"image: "the \"house\".pgm""#),
            ("two\nlines.pgm", r#"image: "two\u000alines.pgm""#),
            ("-1.pgm", r#"image: "-1.pgm""#),
        ] {
            assert_eq!(line(name).as_deref(), Some(expected));
            assert!(is_ros_map_yaml_of(&ros_map_yaml(name, 0.05, [0.0, 0.0]), Path::new(name)), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn an_image_that_no_description_can_name_is_not_written() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        let stem = folder.path().join(std::ffi::OsStr::from_bytes(b"x\xffy"));
        let map =
            PaintedMap { width: 1, height: 1, resolution: 0.05, origin: [0.0, 0.0], pixels: vec![[0, 255]] };
        let error = write_ros_map(&stem, &map, ImageName::Beside).unwrap_err();
        assert!(error.to_string().contains("UTF-8"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn writes_the_exact_layout() {
        let folder = tempfile::tempdir().unwrap();
        let map = PaintedMap {
            width: 2,
            height: 1,
            resolution: 0.05,
            origin: [5.25, 3.5],
            pixels: vec![[0, 255], [255, 255]],
        };
        let stem = folder.path().join("my.map");
        let (image, description) = write_ros_map(&stem, &map, ImageName::Beside).unwrap();
        assert_eq!(
            std::fs::read(image).unwrap(),
            b"P5\n# Cartographer map; 0.05 m/pixel\n2 1\n255\n\x00\xff"
        );
        let expected = "image: my.map.pgm\nresolution: 0.05\norigin: [-0.2625, 0.125, 0.0]\nnegate: \
                        0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
        assert_eq!(std::fs::read_to_string(description).unwrap(), expected);
    }

    #[test]
    fn places_in_utm_keep_their_millimetres() {
        let text = ros_map_yaml("map.pgm", 0.05, [499_693.975, 5_400_557.951]);
        assert!(text.contains("origin: [499693.975, 5400557.951, 0.0]"), "{text}");
    }
}
