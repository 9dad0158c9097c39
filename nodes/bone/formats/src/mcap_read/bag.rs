//! The folder of a ROS 2 bag: its recordings in order, by `metadata.yaml`.

use super::McapError;
use crate::{FileError, foreign_recording::advice};
use std::{
    fs,
    path::{Path, PathBuf},
};
use yaml_rust2::{Event, parser::Parser};

/// Largest `metadata.yaml`: a bag of a thousand topics has some hundred kilobytes.
const MAX_METADATA_BYTES: u64 = 16 << 20;

/// The recordings of a bag.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Bag {
    pub(super) files: Vec<PathBuf>,
    /// Number of messages that the metadata announce.
    pub(super) n_messages: Option<usize>,
    pub(super) notes: Vec<String>,
}

impl Bag {
    /// Finds the recordings of the bag in `folder`.
    pub(super) fn open(folder: &Path) -> Result<Self, McapError> {
        let fault = |reason: String| McapError::Unreadable { path: folder.display().to_string(), reason };
        let mut there: Vec<String> = Vec::new();
        for entry in fs::read_dir(folder).map_err(FileError::read(folder))? {
            there.extend(entry.map_err(FileError::read(folder))?.file_name().into_string());
        }
        there.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
        let recordings: Vec<&String> = there.iter().filter(|name| name.ends_with(".mcap")).collect();
        let path = folder.join("metadata.yaml");
        if !path.is_file() {
            if recordings.is_empty() {
                let hint = missing(folder, &there);
                return Err(fault(format!("the folder holds neither metadata.yaml nor a recording (.mcap){hint}")));
            }
            let note = format!(
                "{}: no metadata.yaml, which a recorder writes at its end; the folder's {} recordings are read by name",
                folder.display(),
                recordings.len()
            );
            let files = recordings.iter().map(|name| folder.join(name)).collect();
            return Ok(Self { files, n_messages: None, notes: vec![note] });
        }
        let n_bytes = fs::metadata(&path).map_err(FileError::read(&path))?.len();
        if n_bytes > MAX_METADATA_BYTES {
            return Err(fault(format!("metadata.yaml has {n_bytes} bytes, at most {MAX_METADATA_BYTES} are read")));
        }
        let text = osteoflow_container::regular(&path).and_then(fs::read_to_string).map_err(FileError::read(&path))?;
        let metadata = Metadata::of(&text).map_err(|reason| fault(format!("metadata.yaml: {reason}")))?;
        if let Some(storage) = metadata.storage.filter(|storage| storage != "mcap") {
            return Err(fault(format!("the bag is stored as {storage}, and MCAP is read; {}", advice(folder))));
        }
        if metadata.compression.is_some_and(|mode| mode.eq_ignore_ascii_case("message")) {
            return Err(fault(format!(
                "its messages are compressed one by one, which is not read; {}",
                advice(folder)
            )));
        }
        if metadata.files.is_empty() {
            return Err(fault("metadata.yaml names no recording (relative_file_paths)".into()));
        }
        let mut bag = Self { n_messages: metadata.n_messages, ..Self::default() };
        for file in &metadata.files {
            // Other than by its last part, a name would lead out of the folder.
            let Some(name) = Path::new(file).file_name().and_then(|name| name.to_str()) else {
                return Err(fault(format!("metadata.yaml names \"{file}\", which is no file")));
            };
            if !there.iter().any(|other| other == name) {
                return Err(fault(format!("{name} is missing, though metadata.yaml names it")));
            }
            if !name.ends_with(".mcap") {
                return Err(fault(format!("{name} is compressed as a whole; unpack it (zstd -d), or convert the bag")));
            }
            bag.files.push(folder.join(name));
        }
        let n_unnamed = recordings.iter().filter(|name| !bag.files.contains(&folder.join(name))).count();
        if n_unnamed > 0 {
            let folder = folder.display();
            bag.notes
                .push(format!("{folder}: {n_unnamed} recordings are not named in metadata.yaml and were not read"));
        }
        Ok(bag)
    }
}

/// What to do about a folder without recordings.
fn missing(folder: &Path, there: &[String]) -> String {
    if let Some(bag) = there.iter().find(|name| name.ends_with(".db3")) {
        format!("; {bag} is a ROS 2 bag of the older kind, in SQLite; {}", advice(&folder.join(bag)))
    } else if there.iter().any(|name| name.ends_with(".mcap.zstd") || name.ends_with(".mcap.zst")) {
        "; unpack its .mcap.zstd with `zstd -d`".into()
    } else {
        String::new()
    }
}

/// What `metadata.yaml` says of a bag.
#[derive(Debug, Default)]
struct Metadata {
    storage: Option<String>,
    files: Vec<String>,
    compression: Option<String>,
    n_messages: Option<usize>,
}

impl Metadata {
    /// Reads the keys below `rosbag2_bagfile_information`; others, of any depth, are passed over. Events are read one by
    /// one, so that neither depth nor repetition by aliases costs memory.
    fn of(text: &str) -> Result<Self, String> {
        /// Depth of the keys below the one at the top.
        const DEPTH: usize = 2;
        let mut parser = Parser::new(text.chars());
        let (mut metadata, mut depth, mut key) = (Self::default(), 0_usize, None::<String>);
        loop {
            match parser.next_token().map_err(|error| error.to_string())?.0 {
                Event::StreamEnd => return Ok(metadata),
                Event::MappingStart(..) | Event::SequenceStart(..) => {
                    depth += 1;
                    if depth <= DEPTH {
                        key = None;
                    }
                }
                Event::MappingEnd | Event::SequenceEnd => {
                    depth = depth.saturating_sub(1);
                    if depth == DEPTH {
                        key = None;
                    }
                }
                Event::Scalar(value, ..) => match (depth, key.as_deref()) {
                    (DEPTH, None) => key = Some(value),
                    (DEPTH, Some(name)) => {
                        match name {
                            "storage_identifier" => metadata.storage = Some(value),
                            "compression_mode" => metadata.compression = Some(value),
                            "message_count" => {
                                metadata.n_messages =
                                    Some(value.parse().map_err(|_| format!("message_count is \"{value}\""))?);
                            }
                            _ => {}
                        }
                        key = None;
                    }
                    (depth, Some("relative_file_paths")) if depth == DEPTH + 1 => metadata.files.push(value),
                    _ => {}
                },
                Event::Alias(_) if depth == DEPTH => key = None,
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const METADATA: &str = "\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  relative_file_paths:
    - bag_0.mcap
    - bag/bag_1.mcap
  duration: {nanoseconds: 5}
  message_count: 12
  topics_with_message_count:
    - topic_metadata: {name: /scan, type: sensor_msgs/msg/PointCloud2, offered_qos_profiles: \"\"}
      message_count: 3
  compression_format: \"\"
  compression_mode: \"\"
  files:
    - path: bag_0.mcap
      message_count: 7
";

    fn bag(metadata: &str, files: &[&str]) -> Result<Bag, String> {
        let dir = tempfile::tempdir().map_err(|error| error.to_string())?;
        for (name, text) in files.iter().map(|name| (*name, "")).chain([("metadata.yaml", metadata)]) {
            fs::write(dir.path().join(name), text).map_err(|error| error.to_string())?;
        }
        if metadata.is_empty() {
            fs::remove_file(dir.path().join("metadata.yaml")).map_err(|error| error.to_string())?;
        }
        let mut bag = Bag::open(dir.path()).map_err(|error| error.to_string())?;
        bag.files.iter_mut().for_each(|file| *file = file.file_name().map(PathBuf::from).unwrap_or_default());
        Ok(bag)
    }

    #[test]
    fn the_recordings_of_a_bag_come_in_the_order_of_its_metadata() {
        let result = bag(METADATA, &["bag_1.mcap", "bag_0.mcap", "bag_2.mcap"]).unwrap();
        assert_eq!(result.files, [PathBuf::from("bag_0.mcap"), "bag_1.mcap".into()]);
        assert_eq!(result.n_messages, Some(12), "that of the bag, not of a topic or a file");
        assert!(result.notes[0].ends_with("1 recordings are not named in metadata.yaml and were not read"));
    }

    #[test]
    fn without_metadata_the_recordings_are_read_by_name_with_a_note() {
        let result = bag("", &["bag_10.mcap", "bag_2.mcap", "bag_0.mcap"]).unwrap();
        assert_eq!(result.files, ["bag_0.mcap", "bag_2.mcap", "bag_10.mcap"].map(PathBuf::from));
        assert!(result.notes[0].contains("no metadata.yaml"), "{:?}", result.notes);
    }

    #[test]
    fn a_bag_that_cannot_be_read_says_why() {
        let with = |from: &str, to: &str| METADATA.replace(from, to);
        let files = ["bag_0.mcap", "bag_1.mcap"];
        for (metadata, files, expected) in [
            (METADATA.into(), &files[..1], "bag_1.mcap is missing, though metadata.yaml names it"),
            (
                with(": mcap", ": sqlite3"),
                &files[..],
                "the bag is stored as sqlite3, and MCAP is read; convert it with `rosbags-convert --src ",
            ),
            (with("compression_mode: \"\"", "compression_mode: MESSAGE"), &files[..], "are compressed one by one"),
            (with("    - bag_0.mcap\n    - bag/bag_1.mcap\n", ""), &files[..], "names no recording"),
            (with("bag_0.mcap", "bag_0.mcap.zstd"), &["bag_0.mcap.zstd", "bag_1.mcap"], "unpack it (zstd -d)"),
            (with("- bag_0.mcap", "- .."), &files[..], "names \"..\", which is no file"),
            (with("message_count: 12", "message_count: many"), &files[..], "message_count is \"many\""),
            ("a: [b".into(), &files[..], "metadata.yaml: "),
            (
                String::new(),
                &["a.db3"],
                "is a ROS 2 bag of the older kind, in SQLite; convert it with `rosbags-convert --src ",
            ),
            (String::new(), &["a.mcap.zstd"], "unpack its .mcap.zstd"),
            (String::new(), &[], "neither metadata.yaml nor a recording (.mcap)"),
        ] {
            let error = bag(&metadata, files).unwrap_err();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
    }

    #[test]
    fn an_alias_is_the_value_of_its_key_and_the_next_word_a_key() {
        let text = "bag:\n  version: &v 5\n  other: *v\n  storage_identifier: mcap\n  relative_file_paths:\n    - *v\n    - a.mcap\n";
        let result = Metadata::of(text).unwrap();
        assert_eq!((result.storage.as_deref(), &result.files[..]), (Some("mcap"), &["a.mcap".to_owned()][..]));
    }

    #[test]
    fn nesting_and_aliases_cost_nothing() {
        let nested = format!("a:\n  b: {}1{}\n", "[".repeat(100_000), "]".repeat(100_000));
        let aliases: String =
            (0..60).map(|k| format!("  k{k}: &k{k} [*k{0}, *k{0}]\n", k.max(1) - 1)).collect::<String>();
        for text in [nested, format!("a:\n  k: &k 1\n{aliases}")] {
            let _ = Metadata::of(&text);
        }
    }
}
