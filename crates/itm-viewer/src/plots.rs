//! Plots over the frames.

use egui::{Color32, RichText, Ui};
use egui_plot::{AxisHints, Line, Plot, PlotPoints, Points, VLine};

use crate::engine::state::{Row, State, Verdict};
use crate::theme;

/// What is plotted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Plotted {
    /// Milliseconds of each stage.
    #[default]
    Time,
    /// Blocks or surfels, and memory.
    Map,
    /// Residuals of tracking.
    Residual,
}

impl Plotted {
    pub(crate) const ALL: [(Self, &'static str, &'static str); 3] = [
        (Self::Time, "Time", "Milliseconds that each stage takes, and the frame as a whole"),
        (Self::Map, "Map", "Blocks or surfels in use, and the device memory of the map"),
        (
            Self::Residual,
            "Residual",
            "Root mean square of what tracking leaves, in millimetres; dots are poor and lost frames",
        ),
    ];
}

/// Points that a line has at most.
const POINTS: usize = 500;
/// Stages that are shown, the longest first.
const STAGES: usize = 6;

/// Draws a plot, with what its lines are below it: in it they would be covered in so small a place.
pub(crate) fn show(ui: &mut Ui, state: &State, plotted: Plotted, height: f32) {
    let rows = &state.rows;
    let stages = longest_stages(rows);
    let size = if state.settings.mode.has_surfels() { "surfels / 1000" } else { "blocks / 1000" };
    let lines: Vec<(&str, Color32)> = match plotted {
        Plotted::Time => {
            let stages = stages.iter().copied().zip(theme::SERIES);
            std::iter::once(("frame, ms", theme::ACCENT)).chain(stages).collect()
        }
        Plotted::Map => vec![(size, theme::SERIES[0]), ("memory, MiB", theme::SERIES[1])],
        Plotted::Residual => vec![
            ("residual, mm", theme::SERIES[0]),
            ("poor", theme::verdict(Verdict::Poor)),
            ("lost", theme::verdict(Verdict::Lost)),
        ],
    };
    let mut plot = Plot::new(("over frames", plotted as u8))
        .height(height)
        .allow_scroll(false)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_boxed_zoom(false)
        .include_y(0.0)
        // The pane is low, and its lines lie near each other.
        .custom_x_axes(vec![AxisHints::new_x().label_spacing(24.0..=40.0)])
        .custom_y_axes(vec![AxisHints::new_y().label_spacing(8.0..=14.0)])
        .show_axes([true, true]);
    if rows.is_empty() {
        plot = plot.include_x(0.0).include_x(100.0).include_y(1.0);
    }
    plot.show(ui, |plot| {
        match plotted {
            Plotted::Time => {
                plot.line(line("frame, ms", rows, |row| row.total_ms).color(theme::ACCENT).width(1.8));
                for (stage, colour) in stages.iter().copied().zip(theme::SERIES) {
                    let of = |row: &Row| row.stages_ms.iter().find(|(name, _)| name == stage).map(|(_, ms)| *ms);
                    plot.line(line(stage, rows, of).color(colour));
                }
            }
            Plotted::Map => {
                plot.line(line(size, rows, |row| row.size.map(|size| f64::from(size) * 1e-3)).color(theme::SERIES[0]));
                plot.line(line("memory, MiB", rows, |row| row.map_mib).color(theme::SERIES[1]));
            }
            Plotted::Residual => {
                plot.line(line("residual, mm", rows, |row| row.residual_mm).color(theme::SERIES[0]));
                for verdict in [Verdict::Poor, Verdict::Lost] {
                    let at = rows.iter().filter(|row| row.verdict == Some(verdict));
                    let points: Vec<_> = at.map(|row| [row.frame as f64, row.residual_mm.unwrap_or(0.0)]).collect();
                    if !points.is_empty() {
                        plot.points(Points::new(verdict.name(), points).radius(2.5).color(theme::verdict(verdict)));
                    }
                }
            }
        }
        if let Some(frame) = &state.frame
            && !rows.is_empty()
        {
            plot.vline(VLine::new("", frame.index as f64).color(Color32::GRAY).width(0.8));
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for (name, colour) in lines {
            ui.label(RichText::new("⏺").color(colour).small());
            ui.label(RichText::new(name).small());
            ui.add_space(5.0);
        }
    });
}

fn line<'a>(name: &str, rows: &[Row], value: impl Fn(&Row) -> Option<f64>) -> Line<'a> {
    // Of many rows every so many are drawn, so that a long recording does not slow the window down.
    let every = rows.len().div_ceil(POINTS).max(1);
    let points = rows.iter().step_by(every).filter_map(|row| Some([row.frame as f64, value(row)?]));
    Line::new(name.to_owned(), PlotPoints::from_iter(points))
}

/// The stages that take longest, by the sum over the last frames.
fn longest_stages(rows: &[Row]) -> Vec<&str> {
    let mut sums: Vec<(&str, f64)> = Vec::new();
    for (name, ms) in rows.iter().rev().take(60).flat_map(|row| &row.stages_ms) {
        match sums.iter_mut().find(|(known, _)| *known == name.as_ref()) {
            Some((_, sum)) => *sum += ms,
            None => sums.push((name.as_ref(), *ms)),
        }
    }
    sums.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut names: Vec<_> = sums.into_iter().take(STAGES).map(|(name, _)| name).collect();
    // Colours stay with their stages as long as the same ones are shown.
    names.sort_unstable();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_stages_are_shown_in_an_order_that_stays() {
        let stages = [
            ("view", 1.0),
            ("track", 9.0),
            ("integrate", 5.0),
            ("raycast", 7.0),
            ("normals", 2.0),
            ("ranges", 0.5),
            ("allocate", 3.0),
        ];
        let rows: Vec<_> = (0..3)
            .map(|frame| Row {
                frame,
                stages_ms: stages.map(|(name, ms)| (name.into(), ms)).to_vec(),
                ..Row::default()
            })
            .collect();
        assert_eq!(longest_stages(&rows), ["allocate", "integrate", "normals", "raycast", "track", "view"]);
    }
}
