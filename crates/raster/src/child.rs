//! Programs that this one runs for a long time.

use std::process::Command;

/// Lets the command end when the thread that starts it ends, however that comes: nothing goes on working in a folder
/// that the next run takes up. Elsewhere than on Linux the command is left as it is.
#[cfg(target_os = "linux")]
#[allow(unsafe_code)]
pub fn ends_with_us(command: &mut Command) {
    use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};
    use std::os::unix::process::CommandExt as _;
    let us = getpid();
    let bind = move || {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        // We may have ended before the kernel was told.
        if getppid() == Some(us) { Ok(()) } else { Err(std::io::ErrorKind::Interrupted.into()) }
    };
    // SAFETY: between fork and exec the closure makes two system calls and allocates nothing.
    unsafe { command.pre_exec(bind) };
}

/// Does nothing: only Linux tells a child that its parent ended.
#[cfg(not(target_os = "linux"))]
pub fn ends_with_us(_: &mut Command) {}
