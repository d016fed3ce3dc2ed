//! Formats a summary as the lines that other programs print (`tools.md §1.1`).

use crate::info::MapInfo;

impl MapInfo {
    /// The lines of `pbstream info` for the file named `file`, in order.
    pub fn lines(&self, file: &str) -> Vec<String> {
        let mut lines = vec![
            format!("Reading pbstream file from '{file}'..."),
            format!("Header: format_version: {}", self.format_version),
        ];
        for trajectory in &self.trajectories {
            lines.push(format!("Trajectory options: {}", trajectory.options.trim_end()));
        }
        lines.extend(self.trajectory_lines());
        lines.extend(self.counter_lines());
        lines
    }

    /// One line for each trajectory.
    pub fn trajectory_lines(&self) -> impl Iterator<Item = String> + '_ {
        self.trajectories
            .iter()
            .map(|t| format!("Trajectory id: {} has #nodes {} has #submaps {}", t.id, t.nodes, t.submaps))
    }

    /// One line for each kind of message, ascending by name.
    pub fn counter_lines(&self) -> impl Iterator<Item = String> + '_ {
        self.counters.iter().map(|(name, count)| format!("SerializedData package contains #{name}: {count}"))
    }
}
