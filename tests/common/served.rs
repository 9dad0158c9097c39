//! A command that serves a page, started by a test.

use super::osteoflow_to_spawn;
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, ExitStatus, Stdio},
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Time after which a test that waits fails.
const LIMIT: Duration = Duration::from_secs(60);

/// A command that serves.
pub(crate) struct Served {
    child: Child,
    /// The last address of the page, and of all roles that were asked for.
    pub(crate) page: String,
    pub(crate) pages: Vec<String>,
    pub(crate) stream: String,
    /// What it says after its addresses.
    rest: Option<JoinHandle<String>>,
}

impl Served {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let mut command = osteoflow_to_spawn();
        let mut child = command.args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let mut said = String::new();
        let mut find = |what: &str| -> String {
            for line in lines.by_ref() {
                said += &format!("{line}\n");
                if let Some(rest) = line.strip_prefix(what) {
                    return rest.split_whitespace().next().unwrap().to_owned();
                }
            }
            panic!("no line begins with {what}: {said}");
        };
        let roles = arguments.iter().find_map(|word| word.strip_prefix("--role="));
        let all = roles.unwrap_or_default().split(',').map(|_| (find("page: "), find("stream: ")));
        let (pages, mut streams): (Vec<_>, Vec<_>) = all.unzip();
        let (page, stream) = (pages[pages.len() - 1].clone(), streams.remove(streams.len() - 1));
        let rest = std::thread::spawn(move || lines.collect::<Vec<_>>().join("\n"));
        Self { child, page, pages, stream, rest: Some(rest) }
    }

    /// `127.0.0.1:PORT` and the token.
    pub(crate) fn parts(&self) -> (&str, &str) {
        self.page.strip_prefix("http://").unwrap().trim_end_matches('/').split_once('/').unwrap()
    }

    /// Its memory, as the system counts it.
    pub(crate) fn resident_bytes(&self) -> f64 {
        let text = std::fs::read_to_string(format!("/proc/{}/statm", self.child.id())).unwrap_or_default();
        text.split(' ').nth(1).and_then(|pages| pages.parse::<f64>().ok()).unwrap_or(0.0) * 4096.0
    }

    /// Interrupts it, and returns what it said.
    pub(crate) fn interrupt_and_read(mut self) -> String {
        let rest = self.rest.take().unwrap();
        self.interrupt();
        rest.join().unwrap()
    }

    pub(crate) fn interrupt(mut self) -> ExitStatus {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        let until = Instant::now() + LIMIT;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < until, "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Sends bytes and returns all that comes back.
    pub(crate) fn raw(&self, bytes: &[u8]) -> String {
        let mut connection = TcpStream::connect(self.parts().0).unwrap();
        connection.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let _ = connection.write_all(bytes);
        let _ = connection.shutdown(std::net::Shutdown::Write);
        let mut answer = Vec::new();
        let _ = connection.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// The answer to a request below the page's address, with its head.
    pub(crate) fn ask(&self, method: &str, path: &str, headers: &str, body: &str) -> String {
        let (host, token) = self.parts();
        let length = body.len();
        self.raw(
            format!(
                "{method} /{token}/{path} HTTP/1.1\r\nHost: {host}\r\n{headers}Content-Length: {length}\r\n\r\n{body}"
            )
            .as_bytes(),
        )
    }

    pub(crate) fn get(&self, path: &str, headers: &str) -> String {
        let (host, token) = self.parts();
        let host = if headers.contains("Host:") { String::new() } else { format!("Host: {host}\r\n") };
        self.raw(format!("GET {} HTTP/1.1\r\n{host}{headers}\r\n", path.replace("TOKEN", token)).as_bytes())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
