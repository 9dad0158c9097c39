//! Requests and responses of HTTP/1.1, as much of it as a page of its own needs: one request to a connection.

use std::{
    io::{self, Read, Write},
    time::Duration,
};

/// Longest head of a request: browsers send a kilobyte.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// Longest body: a plan or a region of interest, with room.
const MAX_BODY_BYTES: usize = 16 << 20;
/// Time for a whole request to come.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// A request.
#[derive(Debug, Default)]
pub(crate) struct Request {
    pub(crate) method: String,
    pub(crate) path: String,
    headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Request {
    /// All values of a header.
    pub(crate) fn all(&self, name: &str) -> Vec<&str> {
        let of_name = self.headers.iter().filter(|(known, _)| known.eq_ignore_ascii_case(name));
        of_name.map(|(_, value)| value.as_str()).collect()
    }

    /// Whether a header lists a word.
    pub(crate) fn lists(&self, name: &str, word: &str) -> bool {
        self.words(name).any(|listed| listed.eq_ignore_ascii_case(word))
    }

    /// The words that a header lists.
    pub(crate) fn words(&self, name: &str) -> impl Iterator<Item = &str> {
        self.all(name).into_iter().flat_map(|value| value.split(',')).map(str::trim)
    }

    /// Reads the head of a request, and what comes with it of the body.
    ///
    /// # Errors
    /// A status and a sentence; `None` if the connection ended or was silent.
    pub(crate) fn read(from: &mut impl Read) -> Result<Self, Option<(u16, &'static str)>> {
        let mut bytes = Vec::new();
        loop {
            let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
            let mut request = httparse::Request::new(&mut headers);
            match request.parse(&bytes) {
                Ok(httparse::Status::Complete(n)) => {
                    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec());
                    let pairs = request.headers.iter().map(|header| Ok((header.name.into(), text(header.value)?)));
                    let headers: Result<Vec<_>, std::string::FromUtf8Error> = pairs.collect();
                    let method = request.method.unwrap_or_default().into();
                    let path = request.path.unwrap_or_default().into();
                    let headers = headers.map_err(|_| Some((400, "a header is no UTF-8")))?;
                    bytes.drain(..n);
                    return Ok(Self { method, path, headers, body: bytes });
                }
                Ok(httparse::Status::Partial) if bytes.len() > MAX_HEAD_BYTES => {
                    return Err(Some((431, "the headers are too long")));
                }
                Ok(httparse::Status::Partial) => read_more(from, &mut bytes)?,
                Err(_) => return Err(Some((400, "this is no request of HTTP/1.1"))),
            }
        }
    }

    /// Reads the rest of the body. Of a sender who may not send it only as much as lets the refusal reach it.
    ///
    /// # Errors
    /// As of [`Self::read`].
    pub(crate) fn read_body(
        &mut self,
        from: &mut impl Read,
        is_admitted: bool,
    ) -> Result<(), Option<(u16, &'static str)>> {
        let n_body = match self.all("content-length")[..] {
            [] => 0,
            [n] => n.parse().map_err(|_| Some((400, "Content-Length is no number")))?,
            _ => return Err(Some((400, "Content-Length is there twice"))),
        };
        if !self.all("transfer-encoding").is_empty() {
            return Err(Some((411, "a Content-Length is needed")));
        }
        if n_body > if is_admitted { MAX_BODY_BYTES } else { MAX_HEAD_BYTES } {
            return Err(Some((413, "the body is too long")));
        }
        while self.body.len() < n_body {
            read_more(from, &mut self.body)?;
        }
        self.body.truncate(n_body);
        Ok(())
    }
}

fn read_more(from: &mut impl Read, bytes: &mut Vec<u8>) -> Result<(), Option<(u16, &'static str)>> {
    let mut buffer = [0; 4096];
    match from.read(&mut buffer) {
        Ok(0) | Err(_) => Err(None),
        Ok(n) => {
            bytes.extend_from_slice(&buffer[..n]);
            Ok(())
        }
    }
}

/// A response.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Response {
    /// The status, such as 200.
    pub(crate) status: u16,
    /// The content type, such as `application/json`.
    pub(crate) content_type: &'static str,
    /// The content.
    pub(crate) body: Vec<u8>,
    /// Further headers, each with its line end.
    pub(crate) headers: String,
}

impl Response {
    /// JSON.
    pub(crate) fn json(value: &serde_json::Value) -> Self {
        Self::new(200, "application/json", value.to_string().into_bytes())
    }

    /// A sentence on what went wrong.
    pub(crate) fn refused(status: u16, message: &str) -> Self {
        Self::new(status, "text/plain; charset=utf-8", format!("{message}\n").into_bytes())
    }

    /// Any content.
    pub(crate) fn new(status: u16, content_type: &'static str, body: Vec<u8>) -> Self {
        Self { status, content_type, body, headers: String::new() }
    }

    /// Writes it. Nothing is cached, framed, or taken for another type, and the token does not travel to other sites.
    pub(crate) fn write(&self, to: &mut impl Write) -> io::Result<()> {
        let Self { status, content_type, body, headers } = self;
        let head = format!(
            "HTTP/1.1 {status} {}\r\nContent-Type: {content_type}\r\nContent-Length: {}\r\nConnection: close\r\n\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\n\
             Referrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n{headers}\r\n",
            if *status == 200 { "OK" } else { "Refused" },
            body.len()
        );
        to.write_all(head.as_bytes())?;
        to.write_all(body)?;
        to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives a byte at a time.
    struct Slow<'a>(&'a [u8]);

    impl Read for Slow<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let n = self.0.len().min(1);
            buffer[..n].copy_from_slice(&self.0[..n]);
            self.0 = &self.0[n..];
            Ok(n)
        }
    }

    fn read(text: &str) -> Result<Request, Option<(u16, &'static str)>> {
        let mut from = Slow(text.as_bytes());
        let mut request = Request::read(&mut from)?;
        request.read_body(&mut from, true).map(|()| request)
    }

    #[test]
    fn a_request_is_read_with_its_body_however_it_is_cut() {
        let request =
            read("POST /a/b HTTP/1.1\r\nHost: x\r\nContent-Length: 3\r\nConnection: keep-alive, Upgrade\r\n\r\nabcd")
                .unwrap();
        assert_eq!((&*request.method, &*request.path, &*request.body), ("POST", "/a/b", &b"abc"[..]));
        assert_eq!(request.all("HOST"), ["x"]);
        assert!(request.lists("connection", "upgrade") && !request.lists("connection", "close"));
    }

    #[test]
    fn a_request_that_is_damaged_or_too_long_is_refused() {
        let long = format!("GET / HTTP/1.1\r\nA: {}", "x".repeat(MAX_HEAD_BYTES));
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "A: x\r\n".repeat(MAX_HEADERS + 1));
        for (text, status) in [
            ("\0\0\0\0", Some(400)),
            ("GET / HTTP/1.1\r\nHost\r\n\r\n", Some(400)),
            (&long, Some(431)),
            (&many, Some(400)),
            ("POST / HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n", Some(413)),
            ("POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", Some(400)),
            ("POST / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n", Some(400)),
            ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", Some(411)),
            ("POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\nab", None),
            ("GET / HT", None),
            ("", None),
        ] {
            assert_eq!(read(text).map(|_| ()).unwrap_err().map(|(status, _)| status), status, "{text:.40}");
        }
    }
}
