//! A recording as a stream: at its own pace, stopped, or from any time.

use crate::{
    indexed::{Entry, IndexedRecording, Messages, last_of_each},
    protocol::{self, PlaybackState},
    stream::{DROPS, Out, Stream, TIMING, TRANSFORM},
};
use osteoflow_container::ReadError;
use osteoflow_engine::run::Listener;
use std::{
    io,
    path::Path,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

/// Interval at which the time is sent while the recording plays.
const CLOCK: Duration = Duration::from_millis(200);
/// Longest wait for the next message, so that the time advances through gaps.
const STEP: Duration = Duration::from_millis(50);

/// Plays a recording into a stream.
pub struct Playback {
    control: Arc<Control>,
    range_ns: (u64, u64),
    problem: Option<String>,
}

/// What the player's thread shares with the viewers' requests.
struct Control {
    state: Mutex<PlayerState>,
    changed: Condvar,
    stream: Arc<Stream>,
}

struct PlayerState {
    state: PlaybackState,
    /// Where to continue, if a viewer asked for a time.
    seek_ns: Option<u64>,
    ends: bool,
}

impl Playback {
    /// Reads where the messages are, and shows the end of the recording, stopped. What is damaged is left out.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read at all; a recording without messages is [`ReadError::Empty`].
    pub fn open(path: &Path, stream: Arc<Stream>) -> Result<Self, ReadError> {
        let IndexedRecording { messages, entries, channels, problem } = IndexedRecording::open(path)?;
        let (Some(first), Some(last)) = (entries.first(), entries.last()) else { return Err(ReadError::Empty) };
        // Constants are logged with the first item, or at the beginning of all time; the first transforms come just before
        // everything else, and with them alone there is nothing to see.
        let is_shown =
            |entry: &&Entry| channels.get(&entry.channel).is_none_or(|channel| channel.schema_name != TRANSFORM);
        let shown = || entries.iter().filter(is_shown).map(|entry| entry.log_time_ns);
        let start = shown().find(|ns| *ns > 1_000_000).or_else(|| shown().next()).unwrap_or(first.log_time_ns);
        let range_ns = (start, last.log_time_ns);
        let adds = channels.values().filter(|channel| [TIMING, DROPS].contains(&&*channel.topic));
        let adds_up = adds.map(|channel| channel.id).collect();
        channels.into_values().for_each(|channel| stream.channel(channel));
        let state = PlaybackState { plays: false, ended: true, at_ns: range_ns.1, speed: 1.0 };
        let player = PlayerState { state, seek_ns: Some(range_ns.1), ends: false };
        let control = Arc::new(Control { state: Mutex::new(player), changed: Condvar::new(), stream });
        let player = Player { messages, entries, next: 0, control: control.clone(), range_ns, adds_up };
        thread::Builder::new().name("playback".into()).spawn(move || player.run())?;
        Ok(Self { control, range_ns, problem })
    }

    /// What is wrong with the file, if it is damaged.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// First and last time, ns.
    pub(crate) fn range_ns(&self) -> (u64, u64) {
        self.range_ns
    }

    /// Plays, stops, or goes to a time.
    pub(crate) fn play(&self, plays: bool, speed: f32, seek_ns: Option<u64>) -> PlaybackState {
        let mut player = self.control.lock();
        if player.ends {
            return player.state;
        }
        let (start, end) = self.range_ns;
        // From the end it plays from the start.
        let again = (plays && player.state.ended && seek_ns.is_none()).then_some(start);
        if let Some(seek) = seek_ns.or(again) {
            let seek = seek.clamp(start, end);
            player.seek_ns = Some(seek);
            player.state.at_ns = seek;
        }
        let ended = player.state.at_ns >= end;
        player.state = PlaybackState { plays: plays && !ended, ended, speed, ..player.state };
        let state = player.state;
        drop(player);
        self.control.changed.notify_one();
        state
    }

    /// How it goes.
    pub(crate) fn state(&self) -> PlaybackState {
        self.control.lock().state
    }
}

impl Drop for Playback {
    fn drop(&mut self) {
        self.control.lock().ends = true;
        self.control.changed.notify_one();
    }
}

impl Control {
    fn lock(&self) -> MutexGuard<'_, PlayerState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The thread that reads and sends.
struct Player {
    messages: Messages,
    entries: Vec<Entry>,
    /// The next message to send.
    next: usize,
    control: Arc<Control>,
    range_ns: (u64, u64),
    /// Channels whose messages add up.
    adds_up: Vec<u16>,
}

impl Player {
    fn run(mut self) {
        // Time of the recording at a time of the clock.
        let mut since = (Instant::now(), self.range_ns.0);
        let mut clock_sent = Instant::now();
        loop {
            let control = self.control.clone();
            let mut player = control.lock();
            if player.ends {
                return;
            }
            if let Some(seek) = player.seek_ns.take() {
                let state = player.state;
                drop(player);
                // Viewers forget what they show, then get what is known at that time.
                self.control.stream.forget();
                self.send_state(&state, true);
                if let Err(error) = self.seek(seek) {
                    return self.fail(&error);
                }
                since = (Instant::now(), seek);
                continue;
            }
            if !player.state.plays {
                drop(control.changed.wait_timeout(player, Duration::from_secs(1)));
                since = (Instant::now(), control.lock().state.at_ns);
                continue;
            }
            // A change of the speed does not move the past.
            let now = Instant::now();
            let passed_ns = (now - since.0).as_nanos() as f64 * f64::from(player.state.speed);
            let at_ns = since.1.saturating_add(passed_ns as u64).min(self.range_ns.1);
            since = (now, at_ns);
            player.state.at_ns = at_ns;
            if at_ns >= self.range_ns.1 {
                player.state = PlaybackState { plays: false, ended: true, ..player.state };
            }
            let state = player.state;
            drop(player);
            if let Err(error) = self.send_until(at_ns) {
                return self.fail(&error);
            }
            if state.ended || clock_sent.elapsed() >= CLOCK {
                self.send_state(&state, false);
                clock_sent = Instant::now();
            }
            if !state.ended {
                let next_ns = self.entries.get(self.next).map_or(at_ns, |entry| entry.log_time_ns);
                let wait = Duration::from_secs_f64(next_ns.saturating_sub(at_ns) as f64 / 1e9 / f64::from(state.speed));
                let player = control.lock();
                if player.seek_ns.is_none() && player.state.plays {
                    drop(control.changed.wait_timeout(player, wait.min(STEP)));
                }
            }
        }
    }

    /// Sends the last message of each channel up to a time, and all of those that add up.
    fn seek(&mut self, at_ns: u64) -> io::Result<()> {
        self.next = self.entries.partition_point(|entry| entry.log_time_ns <= at_ns);
        let last = last_of_each(&self.entries[..self.next]);
        let before = self.entries[..self.next].iter().enumerate();
        let added = before.filter(|(_, entry)| self.adds_up.contains(&entry.channel)).map(|(at, _)| at);
        let mut shown: Vec<usize> = last.into_values().chain(added).collect();
        shown.sort_unstable();
        shown.dedup();
        shown.into_iter().try_for_each(|at| self.send(self.entries[at]))
    }

    fn send_until(&mut self, at_ns: u64) -> io::Result<()> {
        while let Some(entry) = self.entries.get(self.next).copied().filter(|entry| entry.log_time_ns <= at_ns) {
            self.next += 1;
            self.send(entry)?;
        }
        Ok(())
    }

    fn send(&mut self, entry: Entry) -> io::Result<()> {
        let data = self.messages.data(entry)?;
        self.control.stream.message(entry.channel, entry.log_time_ns, data);
        Ok(())
    }

    fn send_state(&self, state: &PlaybackState, did_seek: bool) {
        self.control.stream.send_to_all(&Out::Binary(protocol::playback_state(state, did_seek, "")));
    }

    /// Stops for good: the file has changed or cannot be read any more.
    fn fail(&self, error: &io::Error) {
        let mut player = self.control.lock();
        (player.state.plays, player.ends) = (false, true);
        let state = player.state;
        drop(player);
        self.send_state(&state, false);
        tracing::error!("the recording cannot be played any more: {error}");
        let status = protocol::status(
            protocol::Level::Error,
            &format!("the recording cannot be read any more: {error}"),
            "file",
        );
        self.control.stream.send_to_all(&Out::Text(status));
    }
}
