//! Finds the files that a configuration includes.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Maximum size of a file, bytes.
const MAX_FILE_SIZE: u64 = 16 << 20;

macro_rules! built_in {
    ($($name:literal,)*) => {
        /// The files that are part of the program, by name.
        const BUILT_IN: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../configuration_files/", $name))),)*];
    };
}

built_in! {
    "assets_writer_backpack_2d.lua",
    "assets_writer_backpack_2d_ci.lua",
    "assets_writer_backpack_3d.lua",
    "assets_writer_ros_map.lua",
    "backpack_2d.lua",
    "backpack_2d_localization.lua",
    "backpack_2d_localization_evaluation.lua",
    "backpack_2d_server.lua",
    "backpack_3d.lua",
    "backpack_3d_localization.lua",
    "map_builder.lua",
    "map_builder_server.lua",
    "pose_graph.lua",
    "pr2.lua",
    "revo_lds.lua",
    "taurob_tracker.lua",
    "trajectory_builder.lua",
    "trajectory_builder_2d.lua",
    "trajectory_builder_3d.lua",
    "transform.lua",
    "visualize_pbstream.lua",
}

/// Names of the configuration files that are part of the program, ascending.
pub fn built_in_names() -> Vec<&'static str> {
    BUILT_IN.iter().map(|(name, _)| *name).collect()
}

/// Text of a configuration file that is part of the program.
pub fn built_in_file(name: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// A file that was found.
#[derive(Clone, Debug)]
pub(crate) struct FoundFile {
    /// Its path, or `built-in:NAME`.
    pub path: String,
    /// Its bytes; Lua does not require UTF-8.
    pub content: Vec<u8>,
    /// Whether it is part of the program.
    pub built_in: bool,
}

/// Searches directories in order and finally the files that are part of the program.
#[derive(Clone, Debug, Default)]
pub(crate) struct Resolver {
    pub directories: Vec<PathBuf>,
}

impl Resolver {
    /// The first readable file with this name. As in Cartographer the name is appended to each directory,
    /// even if it begins with a slash.
    pub fn find(&self, name: &str) -> Option<FoundFile> {
        if name.is_empty() {
            return None;
        }
        let on_disk = self.directories.iter().find_map(|directory| {
            let mut path = directory.clone().into_os_string();
            path.push("/");
            path.push(name);
            let path = PathBuf::from(path);
            let content = read_file(&path).ok()?;
            Some(FoundFile { path: path.display().to_string(), content, built_in: false })
        });
        on_disk.or_else(|| {
            let text = built_in_file(name)?;
            let path = format!("built-in:{name}");
            Some(FoundFile { path, content: text.as_bytes().to_vec(), built_in: true })
        })
    }

    /// The searched directories as text.
    pub fn searched(&self) -> Vec<String> {
        self.directories.iter().map(|directory| directory.display().to_string()).collect()
    }
}

/// The bytes of a file of limited size; directories and endless devices are errors.
pub(crate) fn read_file(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut content = Vec::new();
    File::open(path)?.take(MAX_FILE_SIZE + 1).read_to_end(&mut content)?;
    if content.len() as u64 > MAX_FILE_SIZE {
        return Err(std::io::Error::other(format!("larger than {} MiB", MAX_FILE_SIZE >> 20)));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directories_come_before_the_built_in_files() {
        let directory = std::env::temp_dir().join(format!("portolan-resolver-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        std::fs::write(directory.join("pose_graph.lua"), "mine").unwrap();
        let resolver = Resolver { directories: vec![PathBuf::from("/nowhere"), directory.clone()] };
        let own = resolver.find("pose_graph.lua").unwrap();
        assert_eq!((own.content.as_slice(), own.built_in), (b"mine".as_slice(), false));
        assert!(resolver.find("map_builder.lua").unwrap().built_in);
        assert!(resolver.find("").is_none() && resolver.find("nothing.lua").is_none());
        std::fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn the_list_of_built_in_files_is_sorted_and_none_is_empty() {
        assert!(BUILT_IN.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert!(BUILT_IN.iter().all(|(_, text)| !text.is_empty()));
    }
}
