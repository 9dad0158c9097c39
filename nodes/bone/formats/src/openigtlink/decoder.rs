//! Messages in a stream of bytes.

use super::{
    Message,
    bytes::Reader,
    crc64,
    header::{HEADER_BYTES, Header, find},
};

/// Takes a stream of bytes apart, in pieces of any size.
///
/// After damage it goes on at the next bytes that can be a header, so a message is lost only if it was damaged itself. A
/// damaged length can make it wait for a body that never ends; [`Decoder::give_up`] ends that.
#[derive(Debug, Default)]
pub struct Decoder {
    buffer: Vec<u8>,
    at: usize,
    /// Whether the bytes before `at` were damaged, which has been reported.
    is_lost: bool,
    /// Whether a body is taken whose header has 0 for its CRC.
    takes_no_crc: bool,
}

/// Why bytes gave no message: they are no header, after which the next is looked for, or a body that is not the one that was
/// sent, not what its type prescribes, or not whole.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Damage(String);

impl Decoder {
    /// Of a sender that writes no CRC, which is 0 in its headers: such a body is taken unchecked, if it has the form of its type. Any other
    /// CRC is checked.
    pub fn without_crc() -> Self {
        Self { takes_no_crc: true, ..Self::default() }
    }

    /// Adds bytes as they arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..std::mem::take(&mut self.at));
        self.buffer.extend_from_slice(bytes);
    }

    /// Whether the last message is not complete.
    pub fn is_waiting(&self) -> bool {
        self.at < self.buffer.len()
    }

    /// Gives up the message that is not complete: looks for the next header within what came of it.
    pub fn give_up(&mut self) -> Option<Damage> {
        let header = self.header()?.ok()?;
        let n_found = self.buffer.len() - self.at - HEADER_BYTES;
        self.skip();
        Some(Damage(format!("{} ended after {n_found} of {} bytes", header.name(), header.n_body)))
    }

    /// The bytes at hand, as a header; `None` if there are too few.
    fn header(&self) -> Option<Result<Header, String>> {
        let rest = Reader::new(&self.buffer[self.at..]).array().ok()?;
        Some(Header::parse(&rest))
    }

    /// Goes on at the next bytes that can be a header.
    fn skip(&mut self) {
        self.is_lost = true;
        let rest = &self.buffer[self.at..];
        // The last bytes may be the beginning of a header.
        self.at += find(rest).unwrap_or_else(|| (rest.len() + 1).saturating_sub(HEADER_BYTES).max(1));
    }
}

impl Iterator for Decoder {
    type Item = Result<Message, Damage>;

    /// The next message, or the reason why bytes gave none; `None` until more bytes are pushed.
    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let was_lost = self.is_lost;
            let header = match self.header()? {
                Ok(header) => header,
                Err(error) => {
                    self.skip();
                    if was_lost {
                        continue;
                    }
                    return Some(Err(Damage(format!("the stream is out of step: {error}"))));
                }
            };
            let body = self.buffer[self.at + HEADER_BYTES..].get(..header.n_body)?;
            let is_unchecked = self.takes_no_crc && header.crc == 0;
            if !is_unchecked && crc64(body) != header.crc {
                self.skip();
                return Some(Err(Damage(format!(
                    "{}: the CRC of its body is wrong{}",
                    header.name(),
                    if header.crc == 0 { " (0; of a sender that writes none, set crc = false)" } else { "" }
                ))));
            }
            let parsed = Message::parse(&header, body);
            self.at += HEADER_BYTES + header.n_body;
            self.is_lost = false;
            return Some(parsed.map_err(|reason| Damage(format!("{} is malformed: {reason}", header.name()))));
        }
    }
}
