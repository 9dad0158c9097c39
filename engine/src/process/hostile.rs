//! Bytes read as what the process of a node sends, for tests with hostile ones.

use super::{
    segment::{Pool, Views},
    socket::{Received, Socket},
    wire::{Emitted, FiringOutcome, FromWorker, Reply},
};
use crate::recording::codec;
use osteoflow_node::{Body, FiringDone, Item, PayloadType, PortPayload, Value, View};
use rustix::fd::{AsFd, BorrowedFd};
use std::{
    fs::File,
    io::{self, Read},
    os::unix::net::UnixStream,
    thread,
};

/// Descriptors of the shared memory that are sent with the messages.
const N_FDS: usize = 4;

/// Reads messages as the program reads those of a process, and the values that they place in the shared memory. Returns how
/// many could be read.
///
/// # Errors
/// What the program refuses, and errors of the socket.
pub fn read_messages(messages: &[u8], memory: &File, types: &[&'static PayloadType]) -> io::Result<usize> {
    let (ours, theirs) = UnixStream::pair()?;
    thread::scope(|scope| {
        scope.spawn(move || {
            let theirs = Socket::new(theirs);
            // Fails when a message is refused, which closes the connection.
            let _ = theirs.send_bytes(messages, &[memory.as_fd(); N_FDS]);
        });
        read_all(Socket::new(ours), types)
    })
}

fn read_all(mut socket: Socket, types: &[&'static PayloadType]) -> io::Result<usize> {
    let mut views = Views::default();
    let mut values = Vec::new();
    while let Received::Message(message) = socket.receive::<FromWorker>()? {
        let FromWorker::Answer(answer) = message else { continue };
        views.add(&answer.new, socket.take_fds(answer.new.len())?)?;
        for output in answer.outputs {
            if let Emitted::Value(place) = output {
                values.push(views.value(place, PortPayload::Any, types).map_err(io::Error::other)?);
            }
        }
    }
    Ok(values.len())
}

/// The name of a payload, and its view, of an item as processes share it; `None` if it is damaged or has no value.
pub fn named_view(item: &[u8]) -> Option<(String, View)> {
    let item = codec::decode(item).ok()?;
    Some((item.payload?.0, item.body.ok()?))
}

/// The messages of a process that gives this value, and its shared memory.
///
/// # Errors
/// If there is no memory to share.
pub fn messages_of(value: Value) -> io::Result<(Vec<u8>, Vec<u8>)> {
    let mut pool = Pool::default();
    let place = pool.put(&Item { stamp_ns: 0, number: 0, body: Body::Value(value) }, false)?;
    let (mut new, fds) = pool.news();
    let memory = read(&fds[0], place.n_bytes)?;
    // Segments are larger than the item; this one ends with it.
    new[0].n_bytes = place.n_bytes;
    let said = [
        FromWorker::Built { max_delay_ns: 0, silent_after_ns: None, again: false, loads: None },
        FromWorker::Log { level: 3, target: "node".into(), message: "a line".into() },
        FromWorker::Answer(Box::new(Reply {
            item: 0,
            ended: FiringOutcome::Well,
            outputs: vec![Emitted::Value(place), Emitted::Silent],
            context: FiringDone::default(),
            new,
            held: vec![0],
            cpu_ns: 0,
            loads: None,
        })),
    ];
    let mut messages = Vec::new();
    for message in said {
        let message = serde_json::to_vec(&message)?;
        messages.extend((message.len() as u32).to_le_bytes());
        messages.extend(message);
    }
    Ok((messages, memory))
}

fn read(fd: &BorrowedFd<'_>, n_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::from(fd.try_clone_to_owned()?).take(n_bytes).read_to_end(&mut bytes)?;
    Ok(bytes)
}
