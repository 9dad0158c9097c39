//! Messages over a socket, with descriptors of shared memory.

use rustix::{
    fd::{BorrowedFd, OwnedFd},
    io::{Errno, IoSlice, IoSliceMut},
    net::{
        RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage, SendFlags,
        recvmsg, sendmsg,
    },
};
use serde::{Serialize, de::DeserializeOwned};
use std::{collections::VecDeque, io, mem::MaybeUninit, os::unix::net::UnixStream, time::Duration};

/// Descriptors in one message at most; more are sent with the next parts of it.
const MAX_FDS: usize = 64;
/// A longer message is no message of this protocol.
const MAX_BYTES: usize = 64 << 20;

/// A worker that is gone is an error of the call, not a signal to this process; on Apple's systems, which have no such flag, because
/// Rust and Python ignore SIGPIPE.
#[cfg(not(target_vendor = "apple"))]
const SEND: SendFlags = SendFlags::NOSIGNAL;
#[cfg(target_vendor = "apple")]
const SEND: SendFlags = SendFlags::empty();

/// Descriptors that arrive are closed in programs that this process starts; on Apple's systems once they have arrived.
#[cfg(not(target_vendor = "apple"))]
const RECEIVE: RecvFlags = RecvFlags::CMSG_CLOEXEC;
#[cfg(target_vendor = "apple")]
const RECEIVE: RecvFlags = RecvFlags::empty();

/// One end of the connection.
pub(crate) struct Socket {
    stream: UnixStream,
    /// Bytes that have arrived and are not yet a whole message.
    bytes: Vec<u8>,
    /// Descriptors that have arrived and belong to no message yet.
    fds: VecDeque<OwnedFd>,
}

/// What came.
pub(crate) enum Received<T> {
    Message(T),
    /// Nothing within the time.
    Nothing,
    /// The other side is gone.
    Closed,
}

impl Socket {
    pub(crate) fn new(stream: UnixStream) -> Self {
        Self { stream, bytes: Vec::new(), fds: VecDeque::new() }
    }

    /// How long [`Socket::receive`] waits; for ever if `None`.
    pub(crate) fn wait_at_most(&self, limit: Option<Duration>) -> io::Result<()> {
        self.stream.set_read_timeout(limit)
    }

    /// Tells the other side that nothing more comes.
    pub(crate) fn close(&self) {
        let _ = self.stream.shutdown(std::net::Shutdown::Write);
    }

    pub(crate) fn send(&mut self, message: &impl Serialize, fds: &[BorrowedFd<'_>]) -> io::Result<()> {
        let mut bytes = vec![0; 4];
        serde_json::to_writer(&mut bytes, message)?;
        let n_bytes = u32::try_from(bytes.len() - 4).ok().filter(|n| *n as usize <= MAX_BYTES);
        let n_bytes = n_bytes.ok_or_else(|| io::Error::other("the message is longer than 64 MiB"))?;
        bytes[..4].copy_from_slice(&n_bytes.to_le_bytes());
        self.send_bytes(&bytes, fds)
    }

    /// Sends a whole message, with its length.
    pub(super) fn send_bytes(&self, bytes: &[u8], fds: &[BorrowedFd<'_>]) -> io::Result<()> {
        let mut fds = fds.chunks(MAX_FDS);
        let mut left = bytes;
        while !left.is_empty() {
            let now = fds.next().unwrap_or_default();
            // Each part with descriptors carries one byte of the message at least.
            let part = if fds.len() > 0 { &left[..1] } else { left };
            let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MAX_FDS))];
            let mut control = SendAncillaryBuffer::new(&mut space);
            if !now.is_empty() {
                control.push(SendAncillaryMessage::ScmRights(now));
            }
            let sent = loop {
                match sendmsg(&self.stream, &[IoSlice::new(part)], &mut control, SEND) {
                    Err(Errno::INTR) => {}
                    sent => break sent?,
                }
            };
            left = &left[sent..];
        }
        Ok(())
    }

    /// The descriptors that came with the message that was received last.
    pub(crate) fn take_fds(&mut self, n: usize) -> io::Result<Vec<OwnedFd>> {
        if self.fds.len() < n {
            return Err(io::Error::other("it names shared memory that it did not send"));
        }
        Ok(self.fds.drain(..n).collect())
    }

    /// The next message. Descriptors may have arrived for the one after it, too.
    pub(crate) fn receive<T: DeserializeOwned>(&mut self) -> io::Result<Received<T>> {
        loop {
            if let Some(length) = self.bytes.first_chunk::<4>().map(|n| u32::from_le_bytes(*n) as usize) {
                if length > MAX_BYTES {
                    return Err(io::Error::other("it sends what is no message"));
                }
                if let Some(message) = self.bytes.get(4..4 + length) {
                    let message = serde_json::from_slice(message)?;
                    self.bytes.drain(..4 + length);
                    return Ok(Received::Message(message));
                }
            }
            let mut buffer = [0; 16 << 10];
            let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MAX_FDS))];
            let mut control = RecvAncillaryBuffer::new(&mut space);
            let n_bytes = match recvmsg(&self.stream, &mut [IoSliceMut::new(&mut buffer)], &mut control, RECEIVE) {
                Ok(received) => received.bytes,
                Err(Errno::INTR) => continue,
                Err(Errno::AGAIN) => return Ok(Received::Nothing),
                // What a killed process left unread.
                Err(Errno::CONNRESET) => 0,
                Err(error) => return Err(error.into()),
            };
            for message in control.drain() {
                if let RecvAncillaryMessage::ScmRights(fds) = message {
                    for fd in fds {
                        #[cfg(target_vendor = "apple")]
                        rustix::io::fcntl_setfd(&fd, rustix::io::FdFlags::CLOEXEC)?;
                        self.fds.push_back(fd);
                    }
                }
            }
            if n_bytes == 0 {
                return Ok(Received::Closed);
            }
            self.bytes.extend_from_slice(&buffer[..n_bytes]);
        }
    }
}
