//! Names the node that was being called when the process crashes or is ended by a library.
//!
//! Crashes: a handler of the signals that a crash raises writes one line and lets the signal take its course, so that the
//! exit status, core dumps and debuggers see what they would without it, and Rust adds its message about a stack overflow.
//! The handler runs on the alternate stack that Rust gives to each of its threads. `exit()`: a function that the C library
//! calls at the end of the process finds a call of a node under way, and ends the process with an exit code that is not 0.
#![allow(unsafe_code, reason = "handles signals")]

#[cfg(unix)]
pub(crate) use unix::{install, leave};

#[cfg(not(unix))]
pub(crate) fn install() {}

#[cfg(not(unix))]
pub(crate) fn leave() {}

#[cfg(unix)]
mod unix {
    use crate::commands::common::exit::Exit;
    use osteoflow_engine::{
        activity::{self, Call, Doing},
        plugin::signal_name,
    };
    use std::{
        fmt::{self, Write},
        io::IsTerminal,
        mem::MaybeUninit,
        ptr,
        sync::{
            OnceLock,
            atomic::{AtomicBool, Ordering},
        },
    };

    const SIGNALS: [libc::c_int; 5] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGILL, libc::SIGFPE, libc::SIGABRT];

    /// The handlers that were installed before.
    static BEFORE: [OnceLock<libc::sigaction>; SIGNALS.len()] = [const { OnceLock::new() }; SIGNALS.len()];
    /// A crash has been reported.
    static REPORTED: AtomicBool = AtomicBool::new(false);
    /// The program ends by itself.
    static LEAVING: AtomicBool = AtomicBool::new(false);
    /// A line of progress may have to be cleared first.
    static ON_TERMINAL: AtomicBool = AtomicBool::new(false);

    /// Reports crashes and ends of the process from here on.
    pub(crate) fn install() {
        ON_TERMINAL.store(std::io::stderr().is_terminal(), Ordering::Relaxed);
        for (signal, before) in SIGNALS.iter().zip(&BEFORE) {
            let mut old = MaybeUninit::uninit();
            // SAFETY: a zeroed sigaction is a valid one without flags; the handler has the type that SA_SIGINFO asks for.
            unsafe {
                if libc::sigaction(*signal, ptr::null(), old.as_mut_ptr()) != 0 {
                    continue;
                }
                // Before the handler, which reads it.
                let _ = before.set(old.assume_init());
                let mut new: libc::sigaction = std::mem::zeroed();
                new.sa_sigaction = on_signal as *const () as usize;
                new.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
                libc::sigaction(*signal, &new, ptr::null_mut());
            }
        }
        // SAFETY: the function is called once, at the end of the process.
        unsafe { libc::atexit(at_exit) };
    }

    /// The program is about to end by itself; nodes may be left behind in the middle of a call.
    pub(crate) fn leave() {
        LEAVING.store(true, Ordering::Relaxed);
    }

    /// Calls only what a signal handler may call: no lock, no allocation.
    extern "C" fn on_signal(signal: libc::c_int, info: *mut libc::siginfo_t, _context: *mut libc::c_void) {
        if !REPORTED.swap(true, Ordering::Relaxed) {
            report_calls("crashed", signal_name(signal).unwrap_or("a signal"));
        }
        // The handlers of before, for this signal and for an abort that follows it.
        // SAFETY: they are those that the system gave.
        unsafe {
            for (known, before) in SIGNALS.iter().zip(&BEFORE) {
                if let Some(before) = before.get() {
                    libc::sigaction(*known, before, ptr::null_mut());
                }
            }
            // A fault happens again when this returns, and then meets the handler of before. A signal that was sent, as
            // by abort(), would be lost.
            if info.is_null() || (*info).si_code <= 0 {
                let mut default: libc::sigaction = std::mem::zeroed();
                default.sa_sigaction = libc::SIG_DFL;
                libc::sigaction(signal, &default, ptr::null_mut());
                libc::raise(signal);
            }
        }
    }

    extern "C" fn at_exit() {
        let is_over = LEAVING.load(Ordering::Relaxed) && activity::here().is_none();
        if is_over || REPORTED.swap(true, Ordering::Relaxed) {
            return;
        }
        if report_calls("ended", "it called exit(), which ends the program") {
            // SAFETY: what is left in the buffers of C is written, and the process ends here.
            unsafe {
                libc::fflush(ptr::null_mut());
                libc::_exit(Exit::Failed.code().into());
            }
        }
    }

    /// Writes a line with the calls under way: that of this thread, otherwise those of all. Returns whether there is one. Formatting
    /// words and numbers takes no lock and allocates nothing.
    fn report_calls(word: &str, what: &str) -> bool {
        let mut line = Line { bytes: [0; 1024], length: 0 };
        let clear = if ON_TERMINAL.load(Ordering::Relaxed) { "\r\x1b[K" } else { "" };
        let _ = write!(line, "{clear}{word}: ");
        match activity::here() {
            Some(call) => line.call(&call),
            None => {
                let mut before = "on a thread that no node was called on, during ";
                for (_, call) in activity::everywhere() {
                    let _ = line.write_str(std::mem::replace(&mut before, "; "));
                    line.call(&call);
                }
                if before != "; " {
                    return false;
                }
            }
        }
        let _ = writeln!(line, ": {what}");
        line.print();
        true
    }

    /// A line of limited length.
    struct Line {
        bytes: [u8; 1024],
        length: usize,
    }

    impl fmt::Write for Line {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            let n = text.len().min(self.bytes.len() - self.length);
            self.bytes[self.length..][..n].copy_from_slice(&text.as_bytes()[..n]);
            self.length += n;
            Ok(())
        }
    }

    impl Line {
        fn call(&mut self, call: &Call) {
            let _ = write!(self, "node \"{}\", ", call.node);
            let _ = match call.doing {
                Doing::Building => self.write_str("while it was built"),
                Doing::Firing | Doing::Waiting => write!(self, "item {}", call.item),
                Doing::Destroying => self.write_str("while it was destroyed"),
                Doing::Closing => self.write_str("while it was destroyed after the files of the run were written"),
            };
            if let Some(library) = call.library {
                let _ = write!(self, ", in plugin {library}");
            }
        }

        fn print(&self) {
            let mut rest = &self.bytes[..self.length];
            while !rest.is_empty() {
                // SAFETY: the bytes are valid for reads.
                let n = unsafe { libc::write(libc::STDERR_FILENO, rest.as_ptr().cast(), rest.len()) };
                match usize::try_from(n) {
                    Ok(n) if n > 0 => rest = &rest[n..],
                    _ => return,
                }
            }
        }
    }
}
