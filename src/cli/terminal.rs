//! The terminal: progress as a live line on a screen or as plain lines in a log, and the command line that called.

use crate::progress::{Progress, Silent};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::ffi::OsString;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// What the program was called with last; it need not be this process's own command line.
static CALLED_WITH: Mutex<Option<String>> = Mutex::new(None);

/// Notes a command line for reports.
pub(super) fn called_with(arguments: &[OsString]) {
    *CALLED_WITH.lock().unwrap_or_else(PoisonError::into_inner) = Some(joined(arguments));
}

/// The command line for a report; bytes that are no text become replacement characters.
pub(super) fn command_line() -> String {
    let called = CALLED_WITH.lock().unwrap_or_else(PoisonError::into_inner).clone();
    called.unwrap_or_else(|| joined(&std::env::args_os().collect::<Vec<_>>()))
}

fn joined(arguments: &[OsString]) -> String {
    arguments.iter().map(|a| typed(&a.to_string_lossy())).collect::<Vec<_>>().join(" ")
}

/// An argument as it is typed in a shell, so that the command of a report runs again where a name has spaces.
fn typed(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%#".contains(c) || (cfg!(windows) && c == '\\');
    match !text.is_empty() && text.chars().all(plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

/// Progress on the terminal, or none.
pub(super) fn progress(quiet: bool) -> Box<dyn Progress> {
    if quiet { Box::new(Silent) } else { Box::new(Terminal::new()) }
}

/// Shows what a run is doing on standard error.
///
/// On a screen one live line shows the stage, its bar and the unit at work, and stays as a line with its time when the
/// stage ends. Elsewhere each stage writes a line when it begins and one when it ends.
pub struct Terminal {
    shown: Mutex<Shown>,
}

/// What the current stage has on display.
struct Shown {
    stage: String,
    /// The live line, on a screen only.
    bar: Option<ProgressBar>,
    /// Where lines go.
    lines: Lines,
}

enum Lines {
    Screen,
    Plain(Box<dyn Write + Send>),
}

impl Terminal {
    /// Progress on standard error, live when that is a screen.
    pub fn new() -> Self {
        let stderr = std::io::stderr();
        if stderr.is_terminal() { Self::with(Lines::Screen) } else { Self::plain(stderr) }
    }

    /// Progress as plain lines.
    pub fn plain(out: impl Write + Send + 'static) -> Self {
        Self::with(Lines::Plain(Box::new(out)))
    }

    fn with(lines: Lines) -> Self {
        Self { shown: Mutex::new(Shown { stage: String::new(), bar: None, lines }) }
    }

    fn update(&self, act: impl FnOnce(&mut Shown)) {
        // A panic elsewhere must not hide behind one about progress.
        act(&mut self.shown.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

impl Default for Terminal {
    fn default() -> Self {
        Self::new()
    }
}

impl Lines {
    /// Writes a line; a closed terminal is no reason to stop a run.
    fn write(&mut self, line: &str) {
        if let Self::Plain(out) = self {
            let _ = writeln!(out, "{}", harmless(line)).and_then(|()| out.flush());
        }
    }
}

impl Progress for Terminal {
    fn stage(&self, name: &str) {
        self.update(|shown| {
            name.clone_into(&mut shown.stage);
            match &mut shown.lines {
                Lines::Screen => shown.bar = Some(live_line(name)),
                lines => lines.write(&format!("{name} ...")),
            }
        });
    }

    fn step(&self, done: usize, total: usize, label: &str) {
        self.update(|shown| {
            let Some(bar) = &shown.bar else { return };
            if bar.length() != Some(total as u64) {
                bar.set_length(total as u64);
                bar.set_style(style("{spinner} {prefix:<24} {bar:30} {pos}/{len} {msg}"));
            }
            bar.set_position(done as u64);
            bar.set_message(harmless(label));
        });
    }

    fn note(&self, text: &str) {
        self.update(|shown| match &mut shown.lines {
            Lines::Screen => {
                let bar = live_line(text);
                bar.set_style(style("  {prefix}"));
                bar.finish();
            }
            lines => lines.write(text),
        });
    }

    fn finish(&self, seconds: f64) {
        self.update(|shown| match shown.bar.take() {
            Some(bar) => {
                bar.set_style(style("  {prefix:<24} {msg}"));
                bar.finish_with_message(time(seconds));
            }
            None => {
                let line = format!("{} {}", shown.stage, time(seconds));
                shown.lines.write(&line);
            }
        });
    }
}

/// A live line that turns while nothing is known but the stage.
fn live_line(name: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    bar.set_style(style("{spinner} {prefix:<24} {elapsed} {msg}"));
    bar.set_prefix(harmless(name));
    bar.enable_steady_tick(Duration::from_millis(120));
    bar
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).expect("templates are constants of this file").progress_chars("=> ")
}

/// Text as it may reach a terminal: characters that steer it, or that turn the direction of writing, are spelt out. Texts of
/// files' headers and names end up in messages.
pub fn harmless(text: &str) -> String {
    let steers = |c: char| {
        c.is_control() && !matches!(c, '\n' | '\t') || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if steers(c) { out.extend(c.escape_unicode()) } else { out.push(c) }
    }
    out
}

fn time(seconds: f64) -> String {
    if seconds < 10.0 { format!("{seconds:.2} s") } else { format!("{seconds:.1} s") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// A writer whose text can be looked at.
    #[derive(Clone, Default)]
    struct Shared(Arc<Mutex<Vec<u8>>>);

    impl Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_command_can_be_typed_again() {
        let words = ["aventail", "--out", "out x", "--limit", "cord:D2<=45", "it's", "FOLDER#2"].map(OsString::from);
        assert_eq!(joined(&words), "aventail --out 'out x' --limit 'cord:D2<=45' 'it'\\''s' FOLDER#2");
    }

    #[test]
    fn plain_lines_have_no_control_characters() {
        let out = Shared::default();
        let progress = Terminal::plain(out.clone());
        progress.stage("fit skeleton");
        progress.step(1, 2, "skull");
        progress.step(2, 2, "mandible");
        progress.finish(12.345);
        progress.stage("invert");
        progress.finish(0.5);
        let text = String::from_utf8(out.0.lock().unwrap().clone()).unwrap();
        assert_eq!(text, "fit skeleton ...\nfit skeleton 12.3 s\ninvert ...\ninvert 0.50 s\n");
    }

    #[test]
    fn control_characters_are_spelt_out() {
        assert_eq!(
            harmless("a\u{1b}[2Jb\r\u{7f}\u{9b}\u{202e}\tö\n"),
            "a\\u{1b}[2Jb\\u{d}\\u{7f}\\u{9b}\\u{202e}\tö\n"
        );
    }

    #[test]
    fn live_lines_take_any_order_of_calls() {
        // Tests have no screen: indicatif draws nothing, but the calls must hold together and every template parse.
        let progress = Terminal::with(Lines::Screen);
        progress.finish(1.0);
        progress.step(1, 2, "early");
        progress.stage("fit {skeleton}");
        progress.step(1, 15, "skull");
        progress.step(3, 20, "more than thought");
        progress.update(|shown| {
            let bar = shown.bar.as_ref().unwrap();
            assert_eq!((bar.position(), bar.length(), bar.message().as_str()), (3, Some(20), "more than thought"));
        });
        progress.finish(1.0);
        progress.update(|shown| assert!(shown.bar.is_none()));
    }
}
