#![doc = include_str!("../README.md")]

mod cloud;
mod global;
mod graph;
mod icp;
mod linearized;
mod link;
mod link_file;
mod loop_closing;
mod model;
mod sequence;

pub use cloud::ScanCloud;
pub use global::{GlobalError, GlobalMethod, GlobalOptions, GlobalReport, register_globally};
pub use graph::{Link, links_by_distance, links_by_overlap};
pub use icp::{IcpError, IcpMethod, IcpOptions, IcpResult, RobustKernel, icp};
pub use link::LinkStatistics;
pub use link_file::{BadLinkLine, links_of_text};
pub use loop_closing::{LinkCost, balance, close_loop, link_costs};
pub use model::{Metascan, Model, ModelHit, ModelPoint};
pub use sequence::{
    ClosedLoop, LoopOptions, ModelScans, SequenceOptions, SequenceReport, register_globally_twice,
    register_sequence, unlinked_scans,
};
