//! Reads files beside a capture: metadata of Ouster sensors, found by serial number or file name, and a
//! calibration.

use std::collections::BTreeSet;
use std::path::Path;

use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_packets::{Laser, OusterMetadata, PacketHeader, PacketLayout, parse_calibration};

/// Maximum size of the description of a sensor, bytes; longer files are ignored.
const MAX_DESCRIPTION: u64 = 1 << 22;
/// Limits on the folder of a capture: entries that are listed, files that are read, and their total size in
/// bytes.
const MAX_ENTRIES: usize = 1 << 16;
const MAX_FILES: usize = 256;
const MAX_BYTES: u64 = 1 << 25;

/// Properties of a lidar from its packets.
pub(super) struct Seen<'a> {
    /// Its first packet.
    pub packet: &'a [u8],
    /// Port to which it sends.
    pub port: u16,
    pub largest_column: u16,
}

impl Seen<'_> {
    /// Serial number and initialization number from the packets, with the layout of the metadata or a guessed
    /// one.
    fn identity(&self, metadata: &OusterMetadata) -> (Option<u64>, Option<u32>) {
        let layout = metadata.layout_of(self.packet).or_else(|| PacketLayout::guess(self.packet));
        layout.map_or((None, None), |of| (of.serial(self.packet), of.initialization(self.packet)))
    }

    /// The serial number, without metadata.
    fn serial(&self) -> Option<u64> {
        match PacketLayout::guess(self.packet) {
            Some(layout) => layout.serial(self.packet),
            None => PacketHeader::of(self.packet).serial(self.packet),
        }
    }
}

/// How well the name of a file matches that of the capture; the best match is the greatest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Likeness {
    /// No match, or no more than any two names may have in common.
    Chance,
    /// Whole words match; their total number of characters.
    Words(usize),
    /// `NAME_0`, as ouster-cli names its files: one for each sensor.
    Numbered,
    Same,
}

impl Likeness {
    /// Compares names without their extensions. Common words count if one name consists only of them, or if
    /// there are several and one has a digit, as in a model or a date.
    fn of(capture: &str, file: &str) -> Self {
        if capture == file {
            return Self::Same;
        }
        let rest = file.strip_prefix(capture).and_then(|rest| rest.strip_prefix('_'));
        if rest.is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit())) {
            return Self::Numbered;
        }
        let words = |name: &str| -> Vec<String> {
            let words = name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
            words.map(str::to_owned).collect()
        };
        let (of_capture, of_file) = (words(capture), words(file));
        let common: Vec<&String> =
            of_capture.iter().zip(&of_file).take_while(|(a, b)| a == b).map(|(a, _)| a).collect();
        let is_whole =
            !common.is_empty() && (common.len() == of_capture.len() || common.len() == of_file.len());
        let has_digit = common.iter().any(|word| word.contains(|c: char| c.is_ascii_digit()));
        if is_whole || (common.len() > 1 && has_digit) {
            return Self::Words(common.iter().map(|word| word.len()).sum());
        }
        Self::Chance
    }
}

/// A metadata file.
struct Candidate {
    file: String,
    likeness: Likeness,
    metadata: OusterMetadata,
}

/// The descriptions found beside a capture.
#[derive(Default)]
pub(super) struct Descriptions {
    /// Sorted by name, the best match first.
    candidates: Vec<Candidate>,
    pub calibration: Option<Vec<Laser>>,
}

impl Descriptions {
    /// Reads all metadata in the folder of a capture, and the calibration file with the name of the capture.
    pub fn beside(capture: Option<&Path>) -> Self {
        let Some(capture) = capture else { return Self::default() };
        let calibration = |ending: &str| short_text(&capture.with_extension(ending)).map(|(text, _)| text);
        Self {
            candidates: candidates_beside(capture),
            calibration: calibration("yaml")
                .or_else(|| calibration("yml"))
                .and_then(|text| parse_calibration(&text)),
        }
    }

    /// Sizes of lidar packets according to the metadata, bytes.
    pub fn packet_lengths(&self) -> BTreeSet<usize> {
        self.candidates.iter().filter_map(|candidate| candidate.metadata.packet_bytes()).collect()
    }

    /// The metadata of one of the lidars: by its serial number, else by the name of the file.
    pub fn metadata_of(
        &self,
        lidar: &Seen<'_>,
        all: &[Seen<'_>],
        issues: &mut IssueLog,
    ) -> Option<&OusterMetadata> {
        if let Some(found) = self.of_serial(lidar) {
            if found.likeness != Likeness::Same {
                issues.add(found_in(found, "their serial number is that of its packets"));
            }
            return Some(&found.metadata);
        }
        let others: Vec<u64> = all.iter().filter_map(Seen::serial).collect();
        let found = self.of_name(lidar, &others)?;
        let identity = lidar.identity(&found.metadata).0;
        match (identity, found.metadata.serial) {
            (Some(packets), Some(metadata)) if packets != metadata => {
                let issue = Issue::new(IssueKind::OtherOusterMetadata).with("file", &found.file);
                issues.add(issue.with_number("metadata", metadata).with_number("packets", packets));
            }
            _ if found.likeness != Likeness::Same => {
                issues.add(found_in(
                    found,
                    "their name is closest to that of the capture, and they fit its packets",
                ));
            }
            _ => {}
        }
        Some(&found.metadata)
    }

    /// Metadata with the serial number of the packets. Among several it prefers those that match the packets,
    /// then those with the same initialization number, then those with the best match of the name.
    fn of_serial(&self, lidar: &Seen<'_>) -> Option<&Candidate> {
        let own = self.candidates.iter().filter(|candidate| {
            let serial = candidate.metadata.serial;
            serial.is_some() && serial == lidar.identity(&candidate.metadata).0
        });
        let rank = |candidate: &Candidate| {
            let metadata = &candidate.metadata;
            let start = lidar.identity(metadata).1;
            let is_of_start = start.is_some() && start == metadata.initialization;
            (metadata.describe(lidar.packet, lidar.largest_column), is_of_start, candidate.likeness)
        };
        let own: Vec<&Candidate> = own.collect();
        let best = own.iter().map(|candidate| rank(candidate)).max()?;
        only(own.into_iter().filter(|candidate| rank(candidate) == best), lidar.packet)
    }

    /// Metadata by name, unless they belong to another lidar whose serial number is known.
    fn of_name(&self, lidar: &Seen<'_>, others: &[u64]) -> Option<&Candidate> {
        let is_free = |candidate: &&Candidate| {
            let serial = candidate.metadata.serial;
            let own = lidar.identity(&candidate.metadata).0;
            let is_of_another = serial.is_some_and(|of| own != serial && others.contains(&of));
            // Different serial numbers exclude metadata, unless their file has the name of the capture: then
            // the user chose it.
            let contradicts = own.is_some() && serial.is_some() && own != serial;
            !is_of_another && (!contradicts || candidate.likeness == Likeness::Same)
        };
        let near = self.candidates.iter().filter(|candidate| candidate.likeness > Likeness::Chance);
        let free: Vec<&Candidate> = near.filter(is_free).collect();
        let fits = |candidate: &&&Candidate| candidate.metadata.describe(lidar.packet, lidar.largest_column);
        let best = free.iter().filter(fits).map(|candidate| candidate.likeness).max();
        let Some(best) = best else {
            // Metadata of another configuration. Their beam angles may still apply; otherwise it is reported
            // that they do not match.
            return free.into_iter().find(|candidate| candidate.likeness == Likeness::Same);
        };
        let nearest = || free.iter().filter(fits).filter(|candidate| candidate.likeness == best).copied();
        let to_port = nearest().filter(|candidate| candidate.metadata.lidar_port == Some(lidar.port));
        only(nearest(), lidar.packet).or_else(|| only(to_port, lidar.packet))
    }
}

/// The first of candidates that are all equivalent; none if they are not, or if there are none.
fn only<'a>(mut candidates: impl Iterator<Item = &'a Candidate>, packet: &[u8]) -> Option<&'a Candidate> {
    let first = candidates.next()?;
    candidates.all(|other| first.metadata.agrees(&other.metadata, packet)).then_some(first)
}

fn found_in(candidate: &Candidate, reason: &str) -> Issue {
    Issue::new(IssueKind::OusterMetadataFound).with("file", &candidate.file).with("reason", reason)
}

/// The text of a short file, and its size in bytes.
fn short_text(path: &Path) -> Option<(String, u64)> {
    let size = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?.len();
    let text = if size <= MAX_DESCRIPTION { std::fs::read_to_string(path).ok() } else { None };
    Some((text?, size))
}

/// All metadata in the folder, sorted by the match of the name, then by name.
fn candidates_beside(capture: &Path) -> Vec<Candidate> {
    let Some(stem) = capture.file_stem().map(|stem| stem.to_string_lossy()) else { return Vec::new() };
    let folder = capture.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().take(MAX_ENTRIES).flatten();
    let json = entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|e| e == "json"));
    let mut files: Vec<_> = json
        .map(|path| {
            let name = path.file_stem().map_or_else(Default::default, |name| name.to_string_lossy());
            (std::cmp::Reverse(Likeness::of(&stem, &name)), path.clone())
        })
        .collect();
    files.sort();
    let mut left = MAX_BYTES;
    let mut candidates = Vec::new();
    for (std::cmp::Reverse(likeness), path) in files.into_iter().take(MAX_FILES) {
        let Some((text, size)) = short_text(&path) else { continue };
        let Some(rest) = left.checked_sub(size) else { break };
        left = rest;
        let file = path.file_name().map_or_else(Default::default, |name| name.to_string_lossy()).into_owned();
        let metadata = OusterMetadata::parse(&text);
        candidates.extend(metadata.map(|metadata| Candidate { file, likeness, metadata }));
    }
    candidates
}
