//! Topics of a container and decoding of their messages.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use crate::container::{Compression, Decompressor, most_unpacked};
use crate::{Message, TopicInfo};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_ros_messages::{Decoder, Encoding, MessageKind, normalized_type_name};

/// One publisher of one topic (a connection of a bag, a channel of an MCAP file).
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Connection {
    pub(crate) topic: Arc<str>,
    /// `package/Type`.
    pub(crate) type_name: Arc<str>,
    pub(crate) encoding: Encoding,
}

impl Connection {
    pub(crate) fn new(topic: &str, type_name: &str, encoding: Encoding) -> Self {
        Self { topic: topic.into(), type_name: normalized_type_name(type_name).into(), encoding }
    }

    /// The kind of message that its messages are decoded to, if the type is supported.
    pub(crate) fn kind(&self) -> Option<MessageKind> {
        if self.encoding == Encoding::Unknown { None } else { MessageKind::from_type_name(&self.type_name) }
    }
}

/// Topics in ascending order, from connections and their message counts.
pub(crate) fn topics<'a>(connections: impl Iterator<Item = (&'a Connection, Option<u64>)>) -> Vec<TopicInfo> {
    let mut topics: BTreeMap<(&Arc<str>, &Arc<str>), Option<u64>> = BTreeMap::new();
    for (connection, count) in connections {
        let sum = topics.entry((&connection.topic, &connection.type_name)).or_insert(Some(0));
        *sum = sum.zip(count).map(|(a, b)| a.saturating_add(b));
    }
    let info = |((topic, type_name), count): ((&Arc<str>, &Arc<str>), Option<u64>)| TopicInfo {
        topic: topic.clone(),
        type_name: type_name.clone(),
        count,
    };
    topics.into_iter().map(info).collect()
}

/// Decodes messages of connections. Messages that cannot be decoded are counted by topic.
#[derive(Default)]
pub(crate) struct MessageDecoder {
    decoder: Decoder,
    decompressor: Decompressor,
    unpacked: Vec<u8>,
}

/// Maximum size of a decompressed message, bytes; ROS itself rejects larger ones.
const MAX_MESSAGE_BYTES: u64 = 1 << 30;
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

impl MessageDecoder {
    /// The decoded message, or `None` if it had to be dropped.
    pub(crate) fn decode(
        &mut self,
        connection: &Connection,
        payload: &[u8],
        issues: &mut IssueLog,
    ) -> Option<Message> {
        let Some(kind) = connection.kind() else {
            return Some(Message::Other { type_name: connection.type_name.clone(), bytes: payload.len() });
        };
        let mut payload = Cow::Borrowed(payload);
        // ROS 2 recorders can compress each message. No CDR message starts with this magic number.
        if connection.encoding == Encoding::Cdr && payload.starts_with(&ZSTD_MAGIC) {
            let mut unpacked = std::mem::take(&mut self.unpacked);
            let limit = most_unpacked(payload.len() as u64).min(MAX_MESSAGE_BYTES);
            let zstd = Compression::Zstd;
            if self.decompressor.decompress(zstd, &payload, limit, &mut unpacked).is_err() {
                issues.add(Issue::new(IssueKind::DamagedMessageCompression).with("topic", &connection.topic));
                return None;
            }
            payload = Cow::Owned(unpacked);
        }
        let decoded = self.decoder.decode(kind, connection.encoding, &connection.topic, &payload);
        if let Cow::Owned(buffer) = payload {
            self.unpacked = buffer;
        }
        decoded
            .map_err(|error| {
                let issue = Issue::new(IssueKind::DamagedMessage).with("topic", &connection.topic);
                issues.add(issue.with("type", &connection.type_name).with("error", error));
            })
            .ok()
    }
}
