//! Reads the messages of a database in order of log time.

use std::collections::{BTreeMap, VecDeque};

use portolan_geometry::Time;

use super::database::{Database, MessageRow, is_endless};
use crate::container::{Connection, MessageDecoder};
use crate::{MessageReader, RecordedMessage, RecordingError};
use portolan_issue::{Issue, IssueKind, IssueLog};

/// Number of message positions that are fetched at once; their data are fetched one by one.
const BATCH: i64 = 512;
/// Number of consecutive unreadable rows that are tried one by one. After them steps get longer, because
/// whole branches of the table are lost.
const UNREADABLE_ROWS: u32 = 256;
/// Number of tries with one step length before it is doubled.
const TRIES_PER_STEP: u32 = 64;
/// Maximum step length, rows; beyond it the table ends.
const MAX_STEP: i64 = 1 << 32;

/// Method of finding the next messages.
enum Order {
    /// The database's index of times; key of the last message delivered.
    Index((i64, i64)),
    /// A sorted temporary table; position and key of the last message delivered.
    Sorted(i64, (i64, i64)),
    /// For a damaged database: row by row after this row, without messages at or before the key.
    Rows {
        after: i64,
        delivered: (i64, i64),
    },
    Done,
}

/// One pass over a database.
pub(super) struct Db3Reader {
    database: Database,
    /// Topics by id; `None` for those that were not requested.
    topics: BTreeMap<i64, Option<Connection>>,
    order: Order,
    batch: VecDeque<MessageRow>,
    decoder: MessageDecoder,
    time_range: Option<(i64, i64)>,
    size_bytes: u64,
    last_time: i64,
    issues: IssueLog,
}

impl Db3Reader {
    pub(super) fn new(
        database: Database,
        topics: BTreeMap<i64, Option<Connection>>,
        time_range: Option<(i64, i64)>,
        size_bytes: u64,
        issues: IssueLog,
    ) -> Self {
        let start = (i64::MIN, i64::MIN);
        let order = if database.has_time_index() {
            Order::Index(start)
        } else if database.sort_by_time().is_ok() {
            Order::Sorted(i64::MIN, start)
        } else {
            Order::Rows { after: i64::MIN, delivered: start }
        };
        Self {
            database,
            topics,
            order,
            batch: VecDeque::new(),
            decoder: MessageDecoder::default(),
            time_range,
            size_bytes,
            last_time: i64::MIN,
            issues,
        }
    }

    /// Fetches further message positions; none at the end.
    fn fill(&mut self) {
        let delivered = match &mut self.order {
            Order::Index(after) => match self.database.batch_by_index(*after, BATCH) {
                Ok(batch) if ascends(*after, &batch) => {
                    *after = batch.last().map_or(*after, MessageRow::key);
                    self.batch = batch.into();
                    return;
                }
                Ok(_) | Err(_) => *after,
            },
            Order::Sorted(after, key) => match self.database.batch_by_order(*after, BATCH) {
                // `ascends` rejects repeated messages, which occur if pages of a damaged table refer to each
                // other.
                Ok((place, batch)) if ascends(*key, &batch) => {
                    (*after, *key) = (place.unwrap_or(*after), batch.last().map_or(*key, MessageRow::key));
                    self.batch = batch.into();
                    return;
                }
                // Continue after the last message delivered: everything up to it was delivered in order of
                // time.
                Ok(_) | Err(_) => (self.last_time, i64::MAX),
            },
            Order::Rows { .. } => return self.fill_by_rows(),
            Order::Done => return,
        };
        self.issues.add(IssueKind::DatabaseReadByRow);
        self.order = Order::Rows { after: i64::MIN, delivered };
        self.fill_by_rows();
    }

    fn fill_by_rows(&mut self) {
        let Order::Rows { after, delivered } = &mut self.order else { return };
        let mut unreadable = 0;
        while (self.batch.len() as i64) < BATCH {
            let next = self.database.next_row(*after);
            match next {
                Ok(Some(row)) if row.row > *after => {
                    *after = row.row;
                    unreadable = 0;
                    if row.key() > *delivered {
                        self.batch.push_back(row);
                    }
                    continue;
                }
                // There are no rows after this one.
                Ok(None) => {}
                Err(error) if is_endless(&error) => {
                    self.issues.add(IssueKind::EndlessDatabase);
                }
                // A row before the requested one counts as unreadable: the pages are mixed up.
                Ok(Some(_)) | Err(_) if step_over(unreadable) <= MAX_STEP => {
                    if unreadable == 0 {
                        self.issues.add(IssueKind::DatabaseGap);
                    }
                    *after = (*after).max(0).saturating_add(step_over(unreadable));
                    unreadable += 1;
                    continue;
                }
                Ok(Some(_)) | Err(_) => {}
            }
            self.order = Order::Done;
            return;
        }
    }

    fn decode(&mut self, row: MessageRow) -> Option<RecordedMessage> {
        let Some(connection) = self.topics.get(&row.topic) else {
            self.issues.add(IssueKind::UndescribedTopic);
            return None;
        };
        let connection = connection.as_ref()?;
        let (decoder, issues) = (&mut self.decoder, &mut self.issues);
        let decoded = self.database.with_data(row.row, |data| decoder.decode(connection, data, issues));
        let Ok(message) = decoded else {
            self.issues
                .add(Issue::new(IssueKind::UnreadableDatabaseMessage).with("topic", &connection.topic));
            return None;
        };
        let log_time = Time::from_unix_nanoseconds(row.timestamp);
        message.map(|message| RecordedMessage { topic: connection.topic.clone(), log_time, message })
    }
}

/// Whether the keys of a batch ascend and are all after `after`; in a damaged index they may not.
fn ascends(after: (i64, i64), batch: &[MessageRow]) -> bool {
    batch.first().is_none_or(|first| first.key() > after) && batch.is_sorted_by(|a, b| a.key() < b.key())
}

/// Number of rows to skip after this number of consecutive unreadable ones.
fn step_over(unreadable: u32) -> i64 {
    1i64.checked_shl(unreadable.saturating_sub(UNREADABLE_ROWS) / TRIES_PER_STEP).unwrap_or(i64::MAX)
}

impl MessageReader for Db3Reader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if self.batch.is_empty() {
                self.fill();
            }
            let Some(row) = self.batch.pop_front() else {
                self.order = Order::Done;
                self.last_time = i64::MAX;
                return Ok(None);
            };
            let message = self.decode(row);
            if row.timestamp < self.last_time {
                self.issues.add(IssueKind::DatabaseOutOfOrder);
            }
            self.last_time = self.last_time.max(row.timestamp);
            if message.is_some() {
                return Ok(message);
            }
        }
    }

    /// The position of rows in the file is not known, so progress is estimated from the log time.
    fn position_bytes(&self) -> u64 {
        let Some((first, last)) = self.time_range.filter(|(first, last)| first < last) else { return 0 };
        let (first, last) = (first as f64, last as f64);
        let share = ((self.last_time as f64 - first) / (last - first)).clamp(0.0, 1.0);
        (share * self.size_bytes as f64) as u64
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}
