//! What the program says: results on standard output, everything else on standard error, above the progress bars.

use std::io::{self, ErrorKind, IsTerminal as _, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock, Mutex, Once, PoisonError};
use std::time::Duration;

use anyhow::{Context as _, Result};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// All progress bars, so that lines can be written above them.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Writes a line of results. A reader that has gone away, as `itm devices | head -1` leaves one, is no error.
pub(crate) fn print(text: impl std::fmt::Display) -> Result<()> {
    let mut stdout = io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to standard output"),
    }
}

/// Writes a result as JSON.
pub(crate) fn print_json(value: &impl serde::Serialize) -> Result<()> {
    print(serde_json::to_string_pretty(value)?)
}

/// Writes a line to standard error, above the progress bars.
pub(crate) fn note(text: impl std::fmt::Display) {
    // Nothing can be said where standard error is closed.
    BARS.suspend(|| writeln!(io::stderr(), "{text}").unwrap_or(()));
}

/// Tells an error with its causes.
pub(crate) fn error(error: &anyhow::Error) {
    note(format_args!("error: {error:#}"));
}

/// A progress bar on standard error, `{msg}` behind it; none where that is no terminal, or `quiet`.
pub(crate) fn bar(length: u64, unit: &str, quiet: bool) -> ProgressBar {
    let template = format!("{{bar:28}} {{pos}}/{{len}} {unit} {{msg}}");
    let style = ProgressStyle::with_template(&template).expect("the template is well-formed");
    let bar = ProgressBar::new(length).with_style(style.progress_chars("━━─"));
    if quiet {
        bar.set_draw_target(ProgressDrawTarget::hidden());
        return bar;
    }
    let bar = BARS.add(bar);
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// Sends what libraries log to standard error: warnings, or more if `verbose` or `RUST_LOG` ask for it.
pub(crate) fn start_logging(verbose: bool) {
    // wgpu's lowest layer passes on what drivers say, as that there is none; what matters of it comes as an error.
    let usual =
        if verbose { "info,itm_slam=debug,itm_gpu=debug,itm_io=debug,wgpu_hal=warn" } else { "warn,wgpu_hal=off" };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(usual));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .without_time()
        .with_ansi(io::stderr().is_terminal());
    // Only the first run of a process installs a subscriber, and a host program's own wins.
    let _installed = subscriber.with_writer(AboveBars).try_init();
}

#[derive(Clone, Copy)]
struct AboveBars;

impl<'a> MakeWriter<'a> for AboveBars {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        Self
    }
}

impl io::Write for AboveBars {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        BARS.suspend(|| io::stderr().write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// Status of a program that Ctrl-C ended.
pub(crate) const INTERRUPTED: u8 = 130;

/// The switch of the run under way, and what to say when it is set.
static STOP: Mutex<Option<(Arc<AtomicBool>, &'static str)>> = Mutex::new(None);

/// While this lives, Ctrl-C sets a switch; the second one ends the program at once.
pub(crate) struct StopOnCtrlC(());

impl StopOnCtrlC {
    pub(crate) fn new(switch: Arc<AtomicBool>, what_happens: &'static str) -> Self {
        static HANDLER: Once = Once::new();
        HANDLER.call_once(|| {
            if let Err(error) = ctrlc::set_handler(interrupt) {
                tracing::warn!("Ctrl-C will end the program without results: {error}");
            }
        });
        *STOP.lock().unwrap_or_else(PoisonError::into_inner) = Some((switch, what_happens));
        Self(())
    }
}

impl Drop for StopOnCtrlC {
    fn drop(&mut self) {
        *STOP.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

fn interrupt() {
    let switch = STOP.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match switch {
        Some((switch, what_happens)) if !switch.swap(true, Ordering::Relaxed) => {
            note(format_args!("{what_happens} (Ctrl-C again ends at once)"));
        }
        #[allow(clippy::exit, reason = "the user asked twice, or nothing is under way that could be kept")]
        _ => std::process::exit(INTERRUPTED.into()),
    }
}
