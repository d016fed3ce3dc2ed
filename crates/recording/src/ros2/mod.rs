//! ROS 2 bags: MCAP and SQLite files, alone or in a folder with `metadata.yaml`.

pub(crate) mod db3;
pub(crate) mod folder;
pub(crate) mod mcap;
