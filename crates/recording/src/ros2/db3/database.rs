//! Queries to the database of a ROS 2 bag.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use rusqlite::types::ValueRef;
use rusqlite::{Connection as Sqlite, ErrorCode, OpenFlags, Row, params};

use crate::RecordingError;
use crate::container::{Connection, Source, UnpackedFile};
use portolan_issue::{IssueKind, IssueLog};
use portolan_ros_messages::Encoding;

/// An open database.
pub(super) struct Database {
    sqlite: Sqlite,
    source: Source,
    /// Temporary file of a database whose bytes were in memory.
    _unpacked: Option<Arc<UnpackedFile>>,
}

/// Position of a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageRow {
    /// Nanoseconds since the Unix epoch.
    pub(super) timestamp: i64,
    pub(super) row: i64,
    pub(super) topic: i64,
}

impl MessageRow {
    /// Sort key of messages.
    pub(super) fn key(&self) -> (i64, i64) {
        (self.timestamp, self.row)
    }
}

impl Database {
    /// Opens the database for reading and checks whether it is one of ROS 2.
    pub(super) fn open(source: &Source, issues: &mut IssueLog) -> Result<Self, RecordingError> {
        let unpacked = match source {
            Source::Memory { name, bytes } => Some(Arc::new(unpack(name, bytes)?)),
            _ => None,
        };
        let path = unpacked.as_deref().map(AsRef::<Path>::as_ref).or(source.file()).unwrap_or(source.name());
        let error = |error: rusqlite::Error| unreadable(source.name(), &error);
        let work = most_work(source, path)?;
        let mut sqlite = connect(path, false, work).map_err(error)?;
        let mut tables = tables(&sqlite);
        if matches!(
            code(&tables),
            Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly | ErrorCode::FileLockingProtocolFailed)
        ) {
            // The write-ahead log beside it cannot be used: read the database alone.
            sqlite = connect(path, true, work).map_err(error)?;
            tables = self::tables(&sqlite);
            issues.add(IssueKind::UnusableWriteAheadLog);
        }
        if code(&tables) == Some(ErrorCode::DatabaseCorrupt) {
            // Among other things, this accepts files that are shorter than their header states.
            sqlite.pragma_update(None, "writable_schema", true).map_err(error)?;
            tables = self::tables(&sqlite);
            issues.add(IssueKind::DamagedDatabase);
        }
        let tables = tables.map_err(error)?;
        if !["topics", "messages"].iter().all(|needed| tables.iter().any(|table| table == needed)) {
            return Err(RecordingError::UnknownFormat {
                path: source.name().to_owned(),
                detail:
                    "it is an SQLite database, but not one that ROS 2 recorded (tables topics and messages)"
                        .to_owned(),
            });
        }
        Ok(Self { sqlite, source: source.clone(), _unpacked: unpacked })
    }

    /// The topics by id.
    pub(super) fn topics(&self) -> Result<BTreeMap<i64, Connection>, RecordingError> {
        let read = || -> rusqlite::Result<_> {
            let mut statement =
                self.sqlite.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
            let rows = statement.query_map([], |row| {
                let encoding = match text(row, 3)?.as_str() {
                    "cdr" | "" => Encoding::Cdr,
                    _ => Encoding::Unknown,
                };
                Ok((row.get(0)?, Connection::new(&text(row, 1)?, &text(row, 2)?, encoding)))
            })?;
            rows.collect()
        };
        read().map_err(|error| unreadable(self.source.name(), &error))
    }

    /// Messages per topic, if they can be counted.
    pub(super) fn counts(&self) -> Option<BTreeMap<i64, u64>> {
        let mut statement =
            self.sqlite.prepare("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").ok()?;
        let rows =
            statement.query_map([], |row| Ok((row.get(0)?, row.get::<_, i64>(1)?.unsigned_abs()))).ok()?;
        rows.collect::<Result<_, _>>().ok()
    }

    /// First and last log time.
    pub(super) fn time_range(&self) -> Option<(i64, i64)> {
        let one = |sql| self.sqlite.query_row(sql, [], |row| row.get::<_, Option<i64>>(0)).ok().flatten();
        Some((one("SELECT min(timestamp) FROM messages")?, one("SELECT max(timestamp) FROM messages")?))
    }

    /// Whether messages can be read in order of time without sorting.
    pub(super) fn has_time_index(&self) -> bool {
        let sql = "SELECT count(*) FROM pragma_index_list('messages') AS list, pragma_index_info(list.name) AS info \
                   WHERE list.partial = 0 AND info.seqno = 0 AND info.name = 'timestamp'";
        self.sqlite.query_row(sql, [], |row| row.get(0)).is_ok_and(|count: i64| count > 0)
    }

    /// Sorts the messages into a temporary table (on disk, if it is large).
    pub(super) fn sort_by_time(&self) -> rusqlite::Result<()> {
        self.sqlite.execute_batch(
            "CREATE TEMP TABLE portolan_order AS \
             SELECT timestamp, rowid AS message FROM main.messages ORDER BY timestamp, rowid",
        )
    }

    /// Up to `limit` messages after `(timestamp, row)` in order of time, from the index.
    pub(super) fn batch_by_index(&self, after: (i64, i64), limit: i64) -> rusqlite::Result<Vec<MessageRow>> {
        let mut statement = self.sqlite.prepare_cached(
            "SELECT timestamp, rowid, topic_id FROM messages WHERE (timestamp, rowid) > (?1, ?2) \
             ORDER BY timestamp, rowid LIMIT ?3",
        )?;
        let rows = statement.query_map(params![after.0, after.1, limit], message_row)?;
        rows.collect()
    }

    /// Up to `limit` messages after position `after` of the temporary table, and the position of the last
    /// one. It is an error if the table of messages no longer has such a row.
    pub(super) fn batch_by_order(
        &self,
        after: i64,
        limit: i64,
    ) -> rusqlite::Result<(Option<i64>, Vec<MessageRow>)> {
        let mut statement = self.sqlite.prepare_cached(
            "SELECT o.timestamp, o.message, m.topic_id, o.rowid FROM temp.portolan_order AS o \
             LEFT JOIN main.messages AS m ON m.rowid = o.message WHERE o.rowid > ?1 ORDER BY o.rowid LIMIT ?2",
        )?;
        let rows = statement
            .query_map(params![after, limit], |row| Ok((row.get::<_, i64>(3)?, message_row(row)?)))?;
        let (places, batch): (Vec<_>, _) = rows.collect::<rusqlite::Result<Vec<_>>>()?.into_iter().unzip();
        Ok((places.last().copied(), batch))
    }

    /// The first message after row `after`, in order of rows.
    pub(super) fn next_row(&self, after: i64) -> rusqlite::Result<Option<MessageRow>> {
        let mut statement = self.sqlite.prepare_cached(
            "SELECT timestamp, rowid, topic_id FROM messages WHERE rowid > ?1 ORDER BY rowid LIMIT 1",
        )?;
        let mut rows = statement.query_map(params![after], message_row)?;
        rows.next().transpose()
    }

    /// Passes the serialised message of a row to `use_data`.
    pub(super) fn with_data<T>(&self, row: i64, use_data: impl FnOnce(&[u8]) -> T) -> rusqlite::Result<T> {
        let mut statement = self.sqlite.prepare_cached("SELECT data FROM messages WHERE rowid = ?1")?;
        statement.query_row([row], |row| match row.get_ref(0)? {
            ValueRef::Blob(data) | ValueRef::Text(data) => Ok(use_data(data)),
            other => Err(rusqlite::Error::InvalidColumnType(0, "data".to_owned(), other.data_type())),
        })
    }
}

fn message_row(row: &Row<'_>) -> rusqlite::Result<MessageRow> {
    Ok(MessageRow { timestamp: row.get(0)?, row: row.get(1)?, topic: row.get(2)? })
}

fn text(row: &Row<'_>, column: usize) -> rusqlite::Result<String> {
    Ok(match row.get_ref(column)? {
        ValueRef::Text(text) | ValueRef::Blob(text) => String::from_utf8_lossy(text).into_owned(),
        _ => String::new(),
    })
}

/// Names of the real tables. Views and virtual tables could run arbitrary code, so they are excluded.
fn tables(sqlite: &Sqlite) -> rusqlite::Result<Vec<String>> {
    let mut statement = sqlite
        .prepare("SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'")?;
    let rows = statement.query_map([], |row| text(row, 0))?;
    rows.collect()
}

/// Allowed steps of SQLite's virtual machine per byte of a database. A row takes about 60 steps in all
/// (counting, sorting, fetching), and at least 14 bytes.
const STEPS_PER_BYTE: u64 = 32;
/// Steps that are allowed for a database of any size.
const FREE_STEPS: u64 = 10_000_000;
/// Number of steps between two checks of the limit.
const STEPS_AT_ONCE: u16 = 1000;

/// Maximum number of steps of one pass: pages of a damaged database that refer to each other would never end.
fn most_work(source: &Source, path: &Path) -> Result<u64, RecordingError> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let log_bytes = std::fs::metadata(log).map_or(0, |metadata| metadata.len());
    let bytes = source.open()?.length().saturating_add(log_bytes);
    Ok(bytes.saturating_mul(STEPS_PER_BYTE).saturating_add(FREE_STEPS))
}

/// Whether reading was stopped because it took more steps than any intact database does.
pub(super) fn is_endless(error: &rusqlite::Error) -> bool {
    error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted)
}

fn connect(path: &Path, immutable: bool, mut work: u64) -> rusqlite::Result<Sqlite> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut sqlite = if immutable {
        Sqlite::open_with_flags(immutable_uri(path), flags | OpenFlags::SQLITE_OPEN_URI)?
    } else {
        Sqlite::open_with_flags(path, flags)?
    };
    sqlite.pragma_update(None, "trusted_schema", false)?;
    let is_too_much = move || {
        work = work.saturating_sub(u64::from(STEPS_AT_ONCE));
        work == 0
    };
    sqlite.progress_handler(i32::from(STEPS_AT_ONCE), Some(is_too_much))?;
    Ok(sqlite)
}

fn immutable_uri(path: &Path) -> String {
    let mut uri = "file:".to_owned();
    for byte in path.as_os_str().as_encoded_bytes() {
        if byte.is_ascii_alphanumeric() || b"/-._~".contains(byte) {
            uri.push(char::from(*byte));
        } else {
            let _ = write!(uri, "%{byte:02X}");
        }
    }
    uri + "?immutable=1"
}

fn unpack(name: &Path, bytes: &[u8]) -> Result<UnpackedFile, RecordingError> {
    UnpackedFile::write(|file| file.write_all(bytes))
        .map_err(|source| RecordingError::Io { path: name.to_owned(), source })
}

fn code<T>(result: &rusqlite::Result<T>) -> Option<ErrorCode> {
    result.as_ref().err().and_then(rusqlite::Error::sqlite_error_code)
}

fn unreadable(path: &Path, error: &rusqlite::Error) -> RecordingError {
    RecordingError::Unsupported {
        path: path.to_owned(),
        detail: format!("its database cannot be read ({error}); `sqlite3 FILE .recover` may rescue it"),
    }
}
