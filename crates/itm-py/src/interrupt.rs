//! Ctrl-C, and progress, in calls that take long.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use pyo3::prelude::*;

/// How often Python is asked whether somebody pressed Ctrl-C.
const EVERY: Duration = Duration::from_millis(50);

/// What unwinds from a progress callback up to where the call began.
struct Stopped;

/// Ends the call whose progress callback this is in. The libraries' callbacks cannot say 'stop', and unwinding is how what
/// calls them is left; without the hook for panics, so that nothing is printed.
fn stop() -> ! {
    resume_unwind(Box::new(Stopped))
}

/// Runs a call that [`stop`] may end; `None` where it did.
fn stoppable<T>(call: impl FnOnce() -> T) -> Option<T> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(result) => Some(result),
        Err(payload) if payload.is::<Stopped>() => None,
        Err(payload) => resume_unwind(payload),
    }
}

/// Runs a call with a progress callback, detached from the interpreter. The callback tells `progress`, which takes what is done
/// and what there is in all, and looks for Ctrl-C; an exception of either ends the call.
pub(crate) fn with_progress<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    call: impl FnOnce(&mut dyn FnMut(u32, u32)) -> T + Send,
) -> PyResult<T> {
    let progress = progress.map(|progress| progress.clone().unbind());
    let (result, raised) = py.detach(|| {
        let (mut raised, mut asked) = (None, Instant::now());
        let mut told = |done: u32, all: u32| {
            let due = asked.elapsed() >= EVERY;
            if progress.is_none() && !due {
                return;
            }
            asked = Instant::now();
            let tell = Python::attach(|py| {
                if let Some(progress) = &progress {
                    progress.call1(py, (done, all))?;
                }
                py.check_signals()
            });
            if let Err(error) = tell {
                raised = Some(error);
                stop();
            }
        };
        let result = stoppable(|| call(&mut told));
        (result, raised)
    });
    match (raised, result) {
        (Some(error), _) => Err(error),
        (None, Some(result)) => Ok(result),
        // Nothing else stops a call.
        (None, None) => Err(pyo3::exceptions::PyKeyboardInterrupt::new_err(())),
    }
}

/// Runs a call on another thread, detached from the interpreter, while this one looks for Ctrl-C, which only the main thread is
/// told of. The call is to end early once its argument is set.
pub(crate) fn watched<T: Send>(py: Python<'_>, call: impl FnOnce(&AtomicBool) -> T + Send) -> PyResult<T> {
    let stopping = AtomicBool::new(false);
    py.detach(|| {
        thread::scope(|scope| {
            let worker = scope.spawn(|| call(&stopping));
            let mut raised = None;
            while !worker.is_finished() {
                thread::sleep(Duration::from_millis(5));
                if raised.is_none()
                    && let Err(error) = Python::attach(|py| py.check_signals())
                {
                    stopping.store(true, Ordering::Relaxed);
                    raised = Some(error);
                }
            }
            match (worker.join(), raised) {
                (Err(payload), _) => resume_unwind(payload),
                (Ok(_), Some(error)) => Err(error),
                (Ok(result), None) => Ok(result),
            }
        })
    })
}
