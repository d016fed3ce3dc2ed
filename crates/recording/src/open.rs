//! Opens recordings of any format, recognised by content.

use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use portolan_input::{named, regular_file, unwanted_kind_of};

use crate::container::{Source, UnpackedFile, most_unpacked};
use crate::merge::MergedRecording;
use crate::ros2::{db3, folder, mcap};
use crate::{Recording, RecordingError, kitti, open_text_log, open_text_log_bytes, packets, pcap, ros1};
use portolan_issue::{Issue, IssueKind, IssueLog};

/// Supported formats, for error messages.
const SUPPORTED: &str = "supported are ROS 1 bags (format 2.0), ROS 2 bags (MCAP or SQLite, a file or a folder \
    with metadata.yaml), the same wrapped in zstd, gzip or bzip2, network captures (pcap, pcapng) of Velodyne and \
    Ouster lidars, folders of KITTI, and CARMEN and CoreSLAM logs";

/// Number of bytes at the start of a file that are used to recognise its format.
const PREFIX_BYTES: usize = 256;

/// Opens a recording: a bag, an MCAP file, an SQLite database of ROS 2, a text log, any of them compressed as
/// a whole, a network capture, a folder of KITTI, or a folder with the files of one recording. Extensions are
/// ignored. Raw packets of Velodyne and Ouster lidars are decoded to clouds.
///
/// # Errors
/// Fails if the file cannot be read, is of no known format, is encrypted, or holds nothing readable.
pub fn open(path: impl AsRef<Path>) -> Result<Box<dyn Recording>, RecordingError> {
    packets::unpacked(open_as_it_is(path.as_ref())?)
}

/// Opens a recording without decoding raw packets.
fn open_as_it_is(path: &Path) -> Result<Box<dyn Recording>, RecordingError> {
    let path = &*named(path);
    regular_file(path).map_err(|error| io_error(path, error))?;
    if path.is_dir() {
        if let Some(recording) = kitti::open(path)? {
            return Ok(recording);
        }
        return open_folder(path);
    }
    let source = Source::File(path.into());
    let prefix = source.open()?.peek(0, PREFIX_BYTES)?.to_vec();
    if let Some(recording) = open_container(&source, &prefix)? {
        return Ok(recording);
    }
    if let Some(wrapper) = Wrapper::sniff(&prefix)
        && container_of(&wrapped_prefix(path, wrapper)?).is_some()
    {
        return open_wrapped(path, wrapper);
    }
    match open_text_log(path)? {
        Some(recording) => Ok(recording),
        None => Err(unknown(path, &prefix)),
    }
}

/// Opens several recordings as one, for example the parts of a split bag. They are merged by log time, at
/// equal times in the order given.
///
/// # Errors
/// Fails if one of them cannot be opened, or if there is none.
pub fn open_all<P: AsRef<Path>>(paths: &[P]) -> Result<Box<dyn Recording>, RecordingError> {
    match paths {
        [] => Err(RecordingError::Description { detail: "no recording was named".to_owned() }),
        [path] => open(path),
        paths => {
            let parts: Vec<_> =
                paths.iter().map(|path| open_as_it_is(path.as_ref())).collect::<Result<_, _>>()?;
            let empty = paths.iter().zip(&parts).filter(|(_, part)| part.topics().is_empty());
            let issue =
                |path: &P| Issue::new(IssueKind::EmptyRecording).with("file", path.as_ref().display());
            let issues = empty.map(|(path, _)| issue(path)).collect();
            packets::unpacked(Box::new(MergedRecording::new(parts, issues)))
        }
    }
}

/// Opens a bag, MCAP file, database or text log from bytes in memory. `name` is used in messages.
///
/// # Errors
/// As [`open`].
pub fn open_bytes(name: impl AsRef<Path>, bytes: Arc<[u8]>) -> Result<Box<dyn Recording>, RecordingError> {
    let name = name.as_ref();
    let prefix = bytes.get(..PREFIX_BYTES).unwrap_or(&bytes).to_vec();
    let source = Source::Memory { name: name.into(), bytes };
    if let Some(recording) = open_container(&source, &prefix)? {
        return packets::unpacked(recording);
    }
    let Source::Memory { bytes, .. } = source else { return Err(unknown(name, &prefix)) };
    open_text_log_bytes(name, &bytes)?.ok_or_else(|| unknown(name, &prefix))
}

#[derive(Clone, Copy)]
enum Container {
    Bag,
    Mcap,
    Db3,
    Capture,
}

fn container_of(prefix: &[u8]) -> Option<Container> {
    if ros1::sniff(prefix) {
        Some(Container::Bag)
    } else if mcap::sniff(prefix) {
        Some(Container::Mcap)
    } else if db3::sniff(prefix) {
        Some(Container::Db3)
    } else if pcap::sniff(prefix) {
        Some(Container::Capture)
    } else {
        None
    }
}

fn open_container(source: &Source, prefix: &[u8]) -> Result<Option<Box<dyn Recording>>, RecordingError> {
    Ok(match container_of(prefix) {
        Some(Container::Bag) => Some(ros1::open(source.clone())?),
        Some(Container::Mcap) => Some(mcap::open(source.clone())?),
        Some(Container::Db3) => Some(db3::open(source.clone())?),
        Some(Container::Capture) => Some(pcap::open(source.clone())?),
        None => None,
    })
}

/// Opens the files of a folder. A file that cannot be read is counted as lost; it is an error if all of them
/// fail.
fn open_folder(path: &Path) -> Result<Box<dyn Recording>, RecordingError> {
    let Some(found) = folder::files(path, &is_container)? else {
        return Err(RecordingError::UnknownFormat {
            path: path.to_owned(),
            detail: format!("the folder holds no file of a known format; {SUPPORTED}"),
        });
    };
    let mut issues = IssueLog::default();
    issues.merge(&found.issues);
    let (mut parts, mut first_error) = (Vec::new(), None);
    for file in &found.files {
        match open_as_it_is(file) {
            Ok(part) => parts.push(part),
            Err(error) => {
                issues.add(Issue::new(IssueKind::FileLeftOut).with("error", &error));
                first_error.get_or_insert(error);
            }
        }
    }
    match first_error {
        Some(error) if parts.is_empty() => Err(error),
        _ => Ok(Box::new(MergedRecording::new(parts, issues.list()))),
    }
}

/// Whether a file is a bag, MCAP file or database, compressed as a whole or not.
fn is_container(path: &Path) -> bool {
    let prefix =
        Source::File(path.into()).open().and_then(|mut file| Ok(file.peek(0, PREFIX_BYTES)?.to_vec()));
    let Ok(prefix) = prefix else { return false };
    let inner = Wrapper::sniff(&prefix).and_then(|wrapper| wrapped_prefix(path, wrapper).ok());
    container_of(&prefix).is_some() || inner.is_some_and(|inner| container_of(&inner).is_some())
}

/// Compression of a whole file.
#[derive(Clone, Copy)]
enum Wrapper {
    Zstd,
    Gzip,
    Bzip2,
}

impl Wrapper {
    fn sniff(prefix: &[u8]) -> Option<Self> {
        match prefix {
            [0x28, 0xb5, 0x2f, 0xfd, ..] => Some(Self::Zstd),
            [0x1f, 0x8b, ..] => Some(Self::Gzip),
            [b'B', b'Z', b'h', ..] => Some(Self::Bzip2),
            _ => None,
        }
    }

    fn reader(self, path: &Path) -> io::Result<Box<dyn Read>> {
        let file = BufReader::with_capacity(1 << 16, std::fs::File::open(path)?);
        Ok(match self {
            Self::Zstd => Box::new(zstd::stream::read::Decoder::with_buffer(file)?),
            Self::Gzip => Box::new(flate2::bufread::MultiGzDecoder::new(file)),
            Self::Bzip2 => Box::new(bzip2::bufread::MultiBzDecoder::new(file)),
        })
    }
}

/// The first decompressed bytes of a file; fewer if it is damaged.
fn wrapped_prefix(path: &Path, wrapper: Wrapper) -> Result<Vec<u8>, RecordingError> {
    let mut prefix = Vec::new();
    let reader = wrapper.reader(path).map_err(|error| io_error(path, error))?;
    // Bytes that cannot be decompressed are not a container.
    let _ = reader.take(PREFIX_BYTES as u64).read_to_end(&mut prefix);
    Ok(prefix)
}

/// Decompresses a container into a temporary file first, because containers need random access.
fn open_wrapped(path: &Path, wrapper: Wrapper) -> Result<Box<dyn Recording>, RecordingError> {
    let mut issues = IssueLog::default();
    let file = UnpackedFile::write(|unpacked| unpack(path, wrapper, unpacked, &mut issues));
    let file = Arc::new(file.map_err(|error| io_error(path, error))?);
    let source = Source::Unpacked { original: path.into(), file };
    let prefix = source.open()?.peek(0, PREFIX_BYTES)?.to_vec();
    let recording = open_container(&source, &prefix)?.ok_or_else(|| unknown(path, &prefix))?;
    Ok(Box::new(MergedRecording::new(vec![recording], issues.list())))
}

/// Decompresses everything that can be decompressed.
fn unpack(path: &Path, wrapper: Wrapper, into: &mut dyn io::Write, issues: &mut IssueLog) -> io::Result<()> {
    let mut reader = wrapper.reader(path)?;
    let mut left = most_unpacked(std::fs::metadata(path)?.len());
    let mut block = vec![0; 1 << 16];
    loop {
        match reader.read(&mut block) {
            Ok(0) => return Ok(()),
            Ok(count) if count as u64 > left => {
                issues.add(IssueKind::HighCompression);
                return Ok(());
            }
            Ok(count) => {
                into.write_all(block.get(..count).unwrap_or_default())?;
                left -= count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => {
                issues.add(IssueKind::DamagedCompression);
                return Ok(());
            }
        }
    }
}

fn io_error(path: &Path, source: io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_owned(), source }
}

/// The likely kind of a text of numbers, from the number of columns of its first line.
fn kind_of_numbers(start: &[u8]) -> Option<&'static str> {
    let text = std::str::from_utf8(start).unwrap_or_default();
    let mut lines = text.split_inclusive('\n').filter(|line| line.ends_with('\n') && !line.starts_with('#'));
    let is_separator = |c: char| c.is_ascii_whitespace() || c == ',' || c == ';';
    let mut numbers = lines.next()?.split(is_separator).filter(|word| !word.is_empty());
    let count = numbers.clone().count();
    match numbers.all(|word| word.parse::<f64>().is_ok()).then_some(count)? {
        8 | 12 => {
            Some("a text of poses: `portolan convert` and `portolan evaluate trajectory` read trajectories")
        }
        3..=7 => Some("a text of points: `portolan register` and `portolan evaluate cloud` read clouds"),
        _ => None,
    }
}

/// Why a compressed file is not a recording: it is damaged from its beginning, or it holds something else.
fn compressed(path: &Path, prefix: &[u8]) -> String {
    let inner =
        Wrapper::sniff(prefix).and_then(|wrapper| wrapped_prefix(path, wrapper).ok()).unwrap_or_default();
    match unwanted_kind_of(&inner).or_else(|| kind_of_numbers(&inner)) {
        _ if inner.is_empty() => {
            "it is compressed, and damaged from its beginning: nothing of it can be unpacked; take an undamaged copy".to_owned()
        }
        Some(kind) => format!("it is compressed, and unpacked it is {kind}"),
        None => "it is compressed, and unpacked its content is of no known format".to_owned(),
    }
}

fn unknown(path: &Path, prefix: &[u8]) -> RecordingError {
    let found = match prefix {
        prefix if prefix.starts_with(b"version https://git-lfs") => {
            "it is only the pointer of a git LFS file (run `git lfs pull`)".to_owned()
        }
        prefix if Wrapper::sniff(prefix).is_some() => compressed(path, prefix),
        prefix => match unwanted_kind_of(prefix).or_else(|| kind_of_numbers(prefix)) {
            Some(kind) => format!("it is {kind}"),
            None => "its content is of no known format".to_owned(),
        },
    };
    RecordingError::UnknownFormat { path: PathBuf::from(path), detail: format!("{found}; {SUPPORTED}") }
}
