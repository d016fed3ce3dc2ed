#![doc = include_str!("../README.md")]
#![allow(clippy::expect_used, clippy::panic)] // this is how faults are shown

mod documents;
mod maps;
mod messages;
mod recordings;

pub use documents::{bzip2, cloud, config, g2o, relations, surfaces, trajectory, uos, urdf};
pub use maps::pbstream;
pub use messages::{cdr, packets, pointcloud2};
pub use recordings::{carmen, coreslam, db3, kitti, mcap, pcap, ros1_bag};

/// What is done with the bytes of a fuzzer.
pub type Body = fn(&[u8]);

/// Between the parts of an input that stands for several files.
pub const SEPARATOR: u8 = 0x0c;

/// All of them, by the names of their targets.
pub const BODIES: [(&str, Body); 20] = [
    ("bzip2", bzip2),
    ("carmen", carmen),
    ("cdr", cdr),
    ("cloud", cloud),
    ("config", config),
    ("coreslam", coreslam),
    ("db3", db3),
    ("g2o", g2o),
    ("kitti", kitti),
    ("mcap", mcap),
    ("packets", packets),
    ("pbstream", pbstream),
    ("pcap", pcap),
    ("pointcloud2", pointcloud2),
    ("relations", relations),
    ("ros1_bag", ros1_bag),
    ("surfaces", surfaces),
    ("trajectory", trajectory),
    ("uos", uos),
    ("urdf", urdf),
];

/// The parts of an input that stands for `N` files; those that are missing are empty.
fn parts<const N: usize>(bytes: &[u8]) -> [&[u8]; N] {
    let mut parts = bytes.splitn(N, |byte| *byte == SEPARATOR);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}
