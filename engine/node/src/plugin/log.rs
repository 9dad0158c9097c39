//! Forwards `tracing` events of the plugin to the program.
#![allow(unsafe_code, reason = "calls the functions of the program")]

use crate::{LogForward, abi};

/// [`abi::Plugin::start`]
pub(super) unsafe extern "C" fn start(host: *const abi::Host) {
    // SAFETY: the host table lives as long as the program.
    let Some(host) = (unsafe { host.as_ref::<'static>() }) else { return };
    // A subscriber that the plugin installed itself takes precedence.
    let _ = super::panic::catch(|| {
        // SAFETY: a function of the host table; its result never changes.
        let level = unsafe { (host.log_level)() };
        let forward = LogForward::new(level, |level, target: &str, line: &str| {
            // SAFETY: a function of the host table; the texts are read before the call returns.
            unsafe { (host.log)(level, abi::Text::of(target), abi::Text::of(line)) };
        });
        tracing::subscriber::set_global_default(forward)
    });
}
