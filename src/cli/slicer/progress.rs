//! Progress as Slicer reads it from a module's output (SlicerExecutionModel, "filter-progress").

use crate::progress::Progress;
use std::io::Write;
use std::sync::Mutex;

/// Seconds of work are not known before; after so many stages a run is about done.
const STAGES: f64 = 16.0;

/// Writes a line to standard output for each stage.
#[derive(Default)]
pub(super) struct ForSlicer {
    begun: Mutex<f64>,
}

impl Progress for ForSlicer {
    fn stage(&self, name: &str) {
        let mut begun = self.begun.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        *begun += 1.0;
        let share = (*begun / STAGES).min(0.95);
        // A reader that is gone is no failure of the run.
        let _ = writeln!(std::io::stdout(), "{}", line(name, share)).and_then(|()| std::io::stdout().flush());
    }

    fn step(&self, _: usize, _: usize, _: &str) {}

    fn finish(&self, _: f64) {}
}

fn line(name: &str, share: f64) -> String {
    let name: String = name.chars().filter(|c| !matches!(c, '<' | '>' | '&')).collect();
    format!(
        "<filter-start><filter-name>aventail</filter-name><filter-comment>{name}</filter-comment></filter-start>\n\
         <filter-progress>{share:.2}</filter-progress>"
    )
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_name_cannot_end_its_element() {
        let line = super::line("write <a> & b", 0.5);
        assert!(
            line.contains("<filter-comment>write a  b</filter-comment>") && line.ends_with("0.50</filter-progress>")
        );
    }
}
