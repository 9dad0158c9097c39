//! Recordings of other kinds than MCAP, recognised by their first bytes, and the command that converts them.

use std::path::Path;

/// What a recording is that is no MCAP; none if it is another kind of file.
pub(crate) fn kind(bytes: &[u8]) -> Option<&'static str> {
    const ROS1: (&[u8], &str) = (b"#ROSBAG", "a ROS 1 bag");
    // The first eight bytes are all there is of the start of a recording.
    const SQLITE: (&[u8], &str) = (b"SQLite f", "a ROS 2 bag of the older kind, in SQLite (.db3),");
    [ROS1, SQLITE].into_iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, kind)| kind)
}

/// What to do about a bag that is not read: the command that makes a folder with an MCAP of it, which is.
pub(crate) fn advice(bag: &Path) -> String {
    let mut folder = bag.with_extension("");
    folder.as_mut_os_string().push("_mcap");
    format!(
        "convert it with `rosbags-convert --src {} --dst {} --dst-storage mcap` (pip install rosbags)",
        quoted(bag),
        quoted(&folder)
    )
}

/// A path as a shell takes it.
pub(crate) fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+:@%".contains(c);
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_has_the_names_of_the_bag_and_of_a_new_folder() {
        assert_eq!(
            advice("data/run 1.db3".as_ref()),
            "convert it with `rosbags-convert --src 'data/run 1.db3' --dst 'data/run 1_mcap' --dst-storage mcap` (pip install rosbags)"
        );
        assert!(advice("a.bag".as_ref()).contains("--src a.bag --dst a_mcap "));
    }
}
