//! Reads ROS 2 bags in SQLite databases (`.db3`).

mod database;
mod reader;

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::Time;

use crate::container::{Connection, Source, topics};
use crate::{MessageReader, Recording, RecordingError, TopicInfo};
use database::Database;
use portolan_issue::IssueLog;
use reader::Db3Reader;

/// Whether a file with these first bytes is an SQLite database.
pub(crate) fn sniff(first_bytes: &[u8]) -> bool {
    first_bytes.starts_with(b"SQLite format 3\0")
}

/// Size above which messages are not counted, bytes: counting the messages of each topic reads the whole
/// table.
const MAX_COUNTED_BYTES: u64 = 1 << 29;

/// Opens a database.
pub(crate) fn open(source: Source) -> Result<Box<dyn Recording>, RecordingError> {
    let size_bytes = source.open()?.length();
    let mut issues = IssueLog::default();
    let database = Database::open(&source, &mut issues)?;
    let connections = database.topics()?;
    let counts = if size_bytes <= MAX_COUNTED_BYTES { database.counts() } else { None };
    let time_range = database.time_range();
    Ok(Box::new(Db3Recording { source, size_bytes, connections, counts, time_range }))
}

struct Db3Recording {
    source: Source,
    size_bytes: u64,
    /// By topic id in the database.
    connections: BTreeMap<i64, Connection>,
    counts: Option<BTreeMap<i64, u64>>,
    /// Nanoseconds since the Unix epoch.
    time_range: Option<(i64, i64)>,
}

impl Recording for Db3Recording {
    fn format(&self) -> String {
        "ROS 2 bag (SQLite)".to_owned()
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let count = |id| self.counts.as_ref().map(|counts| counts.get(id).copied().unwrap_or_default());
        topics(self.connections.iter().map(|(id, connection)| (connection, count(id))))
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        self.time_range
            .map(|(first, last)| (Time::from_unix_nanoseconds(first), Time::from_unix_nanoseconds(last)))
    }

    fn size_bytes(&self) -> u64 {
        self.size_bytes
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let chosen: BTreeSet<_> =
            self.topics().into_iter().filter(wanted).map(|t| (t.topic, t.type_name)).collect();
        let connections = self.connections.clone().into_iter();
        let wanted = connections
            .map(|(id, c)| (id, chosen.contains(&(c.topic.clone(), c.type_name.clone())).then_some(c)))
            .collect();
        let mut issues = IssueLog::default();
        let database = Database::open(&self.source, &mut issues)?;
        Ok(Box::new(Db3Reader::new(database, wanted, self.time_range, self.size_bytes, issues)))
    }
}
