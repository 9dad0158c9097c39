//! What viewers have of a recording that was played to its end: the last message of each channel.

use crate::indexed::{IndexedRecording, last_of_each};
use osteoflow_container::ReadError;
use osteoflow_engine::run::ListenedChannel;
use std::path::Path;

/// The bytes of the last message of each channel that `wants` chooses, in the order in which a viewer gets them. What is damaged is
/// left out.
///
/// # Errors
/// [`ReadError`] if the file cannot be read.
pub fn last_messages(
    path: &Path,
    wants: impl Fn(&ListenedChannel) -> bool,
) -> Result<Vec<(ListenedChannel, Vec<u8>)>, ReadError> {
    let mut recording = IndexedRecording::open(path)?;
    let mut last: Vec<usize> = last_of_each(&recording.entries).into_values().collect();
    last.sort_unstable();
    let mut messages = Vec::new();
    for entry in last.into_iter().map(|at| recording.entries[at]) {
        let Some(channel) = recording.channels.get(&entry.channel).filter(|channel| wants(channel)) else { continue };
        messages.push((channel.clone(), recording.messages.data(entry)?));
    }
    Ok(messages)
}
