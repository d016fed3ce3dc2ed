#![doc = include_str!("../README.md")]
#![allow(clippy::expect_used, clippy::panic)] // this is how faults are shown

use std::sync::Once;

mod documents;
mod maps;
mod messages;
mod recordings;

pub use documents::{bzip2, cloud, config, g2o, relations, surfaces, trajectory, uos, urdf};
pub use maps::pbstream;
pub use messages::{cdr, packets, pointcloud2};
pub use recordings::{carmen, coreslam, db3, kitti, mcap, pcap, ros1_bag};

/// Fuzz target: processes the bytes of a fuzzer.
pub type Body = fn(&[u8]);

/// Separator (form feed) between the parts of an input that represents several files.
pub const SEPARATOR: u8 = 0x0c;

/// All fuzz targets by name.
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

/// Panic hooks are no longer called for panics of libraries that readers catch: damage of a file. libFuzzer
/// aborts in its hook.
pub fn ignore_caught_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !portolan_pointcloud::is_panic_caught() {
                usual(panic);
            }
        }));
    });
}

/// Parts of an input that represents `N` files; missing parts are empty.
fn parts<const N: usize>(bytes: &[u8]) -> [&[u8]; N] {
    let mut parts = bytes.splitn(N, |byte| *byte == SEPARATOR);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}
