//! Robot descriptions, and the tree of their frames.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_ingest::{TfTree, parse_urdf};

fuzz_target!(|text: &str| {
    if let Ok(robot) = parse_urdf(text, false) {
        let mut tree = TfTree::new();
        robot.insert_into(&mut tree);
        tree.to_text();
    }
});
