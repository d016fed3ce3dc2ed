//! Compiles the protobuf schema without a system `protoc`.

use std::error::Error;
use std::path::{Path, PathBuf};

use prost::Message;

/// Messages written by hand, in `src/exact_numbers.rs`.
const EXACT: [&str; 7] =
    ["Vector2d", "Vector2f", "Vector3d", "Vector3f", "Vector4f", "Quaterniond", "Quaternionf"];

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new("proto");
    println!("cargo::rerun-if-changed={}", root.display());
    println!("cargo::rerun-if-changed=build.rs");
    let mut files = Vec::new();
    collect(root, &mut files)?;
    files.sort();

    let descriptors = protox::compile(&files, [root])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    // The names of fields, for printing messages as text.
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    let mut config = prost_build::Config::new();
    for name in EXACT {
        config.extern_path(
            format!(".cartographer.transform.proto.{name}"),
            format!("crate::exact_numbers::{name}"),
        );
    }
    config.include_file("messages.rs").compile_fds(descriptors)?;
    Ok(())
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|e| e == "proto") {
            files.push(path);
        }
    }
    Ok(())
}
