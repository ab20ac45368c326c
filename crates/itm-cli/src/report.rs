//! `report.html`: a run on one page that needs no other file.

use std::path::Path;

use anyhow::{Context as _, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::{DVec2, DVec3};
use itm_core::{Se3, Trajectory, evaluation};
use itm_io::recording::RecordingInfo;
use itm_slam::{Submap, SubmapLink, bytes_per_surfel};

use crate::pictures::Picture;
use crate::plot::{self, Curve, Layer, OverFrames};
use crate::summary::Summary;
use crate::timings::{Row, STAGES, median};

/// Messages that the page shows.
const MOST_MESSAGES: usize = 200;
/// Lines about frames that were not good.
const MOST_NOT_GOOD: usize = 40;

/// What the page shows.
pub(crate) struct Report<'a> {
    pub(crate) summary: &'a Summary,
    pub(crate) rows: &'a [Row],
    pub(crate) trajectory: &'a Trajectory,
    pub(crate) info: &'a RecordingInfo,
    pub(crate) pictures: &'a [Picture],
    pub(crate) submaps: &'a [Submap],
    pub(crate) links: &'a [SubmapLink],
    /// Where keyframes were taken (world frame, metres).
    pub(crate) keyframes: &'a [DVec3],
    /// The resolved settings as TOML.
    pub(crate) settings: &'a str,
}

/// Writes the page.
pub(crate) fn write(path: &Path, report: &Report<'_>) -> Result<()> {
    let written = std::fs::write(path, report.html());
    if written.is_err() {
        // Half a page, as a full disk leaves one, is worse than none; where it can't be removed either, the error is told.
        let _may_stay = std::fs::remove_file(path);
    }
    written.with_context(|| format!("cannot write '{}'", path.display()))
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('\'', "&#39;").replace('"', "&quot;")
}

/// The stages whose time follows the number of surfels.
const OVER_SURFELS: [&str; 3] = ["associate", "absorb", "splat"];

fn section(title: &str, body: &str) -> String {
    if body.is_empty() { String::new() } else { format!("<section><h2>{title}</h2>{body}</section>\n") }
}

fn legend<'a>(entries: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let entry = |(class, name): (&str, &str)| format!("<span><i class='{class}'></i>{}</span>", escape(name));
    format!("<div class='legend'>{}</div>", entries.into_iter().map(entry).collect::<String>())
}

/// With thin spaces between thousands.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// A top for the axis of such values that a few of them do not set: they, as a slow first frame, would press all others to
/// the ground. Says where some are beyond it.
fn top_of(mut values: Vec<f64>) -> (f64, Option<String>) {
    values.sort_unstable_by(f64::total_cmp);
    let Some(&largest) = values.last() else { return (1.0, None) };
    let top = (values[(values.len() - 1) * 98 / 100] * 1.15).max(0.01);
    let beyond = match values.iter().filter(|v| **v > top).count() {
        0 => None,
        1 => Some(format!(". 1 frame goes beyond the plot, up to {largest:.0}")),
        cut => Some(format!(". {cut} frames go beyond the plot, up to {largest:.0}")),
    };
    (top, beyond)
}

impl Report<'_> {
    fn html(&self) -> String {
        let name = escape(&self.summary.recording);
        let css = include_str!("report.css");
        let mut page = format!(
            "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>\
             <meta name='viewport' content='width=device-width, initial-scale=1'><title>{name} · itm</title>\
             <style>\n{css}</style></head>\n<body><main>\n<h1>{name}</h1>\n<p class='lead'>{}</p>\n",
            self.lead()
        );
        page += &self.tiles();
        page += &self.errors();
        page += &section("Model", &self.model());
        page += &section("Trajectory", &self.trajectory());
        page += &section("Submaps", &self.submaps());
        page += &section("Tracking", &self.tracking());
        page += &section("Time for each frame", &self.timings());
        page += &section("Surfels", &self.surfels());
        page += &section("Run", &self.table());
        page += &section("Messages", &self.messages());
        let settings = escape(self.settings);
        page += &format!("<section><details><summary>Settings</summary><pre>{settings}</pre></details></section>\n");
        page + "</main></body></html>\n"
    }

    fn lead(&self) -> String {
        let Summary { frames, frames_reached, format, device, poses, stopped, .. } = self.summary;
        let what = if *poses == "given" { "fused at the recording's own poses" } else { "tracked and fused" };
        let reached = if *stopped {
            format!("stopped after {frames_reached} of {frames} frames")
        } else {
            format!("{} frames", grouped(*frames))
        };
        format!("{reached}, {what} · {format} · {} · itm {}", escape(device), env!("CARGO_PKG_VERSION"))
    }

    fn tiles(&self) -> String {
        let s = self.summary;
        let mut tiles = vec![(format!("{:.1} %", s.posed_share * 100.0), "of the frames have a pose".to_string())];
        if s.poor + s.lost > 0 {
            let what = format!("frames not good: {} poor, {} lost", grouped(s.poor), grouped(s.lost));
            tiles.push((grouped(s.poor + s.lost), what));
        }
        if let Some(e) = &s.evaluation {
            tiles.push((format!("{:.1} mm", e.ate.rmse * 1e3), "trajectory error (ATE, rmse)".into()));
            tiles.push((format!("{:.1} mm", e.rpe_translation.rmse * 1e3), "drift a frame (RPE, rmse)".into()));
        }
        if let Some(e) = &s.mesh_error {
            tiles.push((format!("{:.1} mm", e.median_mm), "surface error, median".into()));
        }
        if let Some(ms) = s.median_frame_ms {
            tiles.push((format!("{ms:.1} ms"), "median time of a frame".into()));
        }
        if let Some(mesh) = &s.mesh {
            tiles.push((grouped(mesh.triangles), "triangles in mesh.ply".into()));
        }
        tiles.push((format!("{} MiB", s.map_bytes >> 20), "map on the device".into()));
        let tile = |(value, what)| format!("<div class='tile'><b>{value}</b><span>{what}</span></div>");
        format!("<div class='tiles'>{}</div>\n", tiles.into_iter().map(tile).collect::<String>())
    }

    fn errors(&self) -> String {
        if self.summary.errors.is_empty() {
            return String::new();
        }
        let items: String = self.summary.errors.iter().map(|e| format!("<li>{}</li>", escape(e))).collect();
        format!("<section class='alert'><h2>Something went wrong</h2><ul>{items}</ul></section>\n")
    }

    fn model(&self) -> String {
        if self.pictures.is_empty() {
            return "<p class='note'>No frame has a pose, so there is nothing to show.</p>".into();
        }
        let figure = |picture: &Picture| {
            let title = escape(&picture.title);
            match &picture.png {
                Ok(png) => {
                    let data = BASE64.encode(png);
                    format!(
                        "<figure><img alt='{title}' src='data:image/png;base64,{data}'>\
                         <figcaption>{title}</figcaption></figure>"
                    )
                }
                Err(reason) => {
                    format!("<figure><figcaption>{title}: not shown, {}</figcaption></figure>", escape(reason))
                }
            }
        };
        let figures: String = self.pictures.iter().map(figure).collect();
        format!("<div class='pictures'>{figures}</div>")
    }

    /// From above and from the side, in the axes of the first camera.
    fn trajectory(&self) -> String {
        let poses = self.trajectory.poses();
        let Some(first) = poses.first() else { return String::new() };
        let first_from_world = first.world_from_camera.inverse();
        // The image's up, where a camera's y axis may point either way.
        let up = -self.info.calibration.depth.fy.signum();
        let seen = |p: DVec3| {
            let p = first_from_world.transform_point(p);
            DVec3::new(p.x, up * p.y, p.z)
        };
        let estimate: Vec<DVec3> = poses.iter().map(|p| seen(p.world_from_camera.translation)).collect();
        let (mut truth, mut errors) = (Vec::new(), Vec::new());
        if let (Some(evaluation), Some(known)) = (&self.summary.evaluation, &self.info.ground_truth) {
            let estimate_from_truth: Se3 = evaluation.truth_from_estimate.inverse();
            let pairs = evaluation::associate(self.trajectory, known, evaluation::DEFAULT_TOLERANCE_NS);
            for (estimated, true_one) in pairs {
                let p = estimate_from_truth.transform_point(true_one.world_from_camera.translation);
                truth.push(seen(p));
                errors.push((estimated.timestamp, p.distance(estimated.world_from_camera.translation) * 1e3));
            }
        }
        let view = |project: &dyn Fn(&DVec3) -> DVec2, names: [&str; 2], caption: &str| {
            let curve = |name, class, points: &[DVec3], ends| {
                let points = points.iter().map(project).collect();
                Curve { name, class, points, ends }
            };
            let mut curves = Vec::new();
            if !truth.is_empty() {
                curves.push(curve("ground truth, aligned", "truth", &truth, false));
            }
            curves.push(curve("estimate", "estimate", &estimate, true));
            let names_of_curves = legend(curves.iter().map(|c| (c.class, c.name)));
            let svg = plot::plane(&curves, names, 500.0, 400.0);
            format!("<figure>{names_of_curves}{svg}<figcaption>{caption}</figcaption></figure>")
        };
        let top = view(&|p| DVec2::new(p.x, p.z), ["right (m)", "forward (m)"], "From above");
        let side = view(&|p| DVec2::new(p.z, p.y), ["forward (m)", "up (m)"], "From the side");
        let note = "<p class='note'>Axes of the first camera; ○ start, ■ end.</p>";
        format!("<div class='columns'>{top}{side}</div>{note}{}", self.position_error(&errors))
    }

    /// The graph of the submaps from above, and what their links say; nothing where there is one submap.
    fn submaps(&self) -> String {
        let [first, _, ..] = self.submaps else { return String::new() };
        let seen = |p: DVec3| {
            let p = first.world_from_submap.inverse().transform_point(p);
            DVec2::new(p.x, p.z)
        };
        let at = |number: u16| seen(self.submaps[usize::from(number)].world_from_submap.translation);
        let curve = |class, points| Curve { name: "", class, points, ends: false };
        let way = self.trajectory.poses().iter().map(|pose| seen(pose.world_from_camera.translation)).collect();
        let mut curves = vec![curve("truth", way)];
        // A keyframe is a dot: the shortest of lines with round ends.
        curves.extend(self.keyframes.iter().map(|place| curve("keyframe", vec![seen(*place); 2])));
        for link in self.links {
            curves.push(curve(if link.closure { "closure" } else { "estimate" }, vec![at(link.from), at(link.to)]));
        }
        let names =
            legend([("truth", "camera"), ("keyframe", "keyframes"), ("estimate", "links"), ("closure", "closures")]);
        let svg = plot::plane(&curves, ["right (m)", "forward (m)"], 500.0, 400.0);
        let rows: String = self
            .links
            .iter()
            .map(|link| {
                let measured = link.from_from_to;
                let [a, b] = [link.from, link.to].map(|n| self.submaps[usize::from(n)].world_from_submap);
                let off = measured.inverse() * a.inverse() * b;
                format!(
                    "<tr><td>{} – {}</td><td>{}</td><td>{:.2}</td><td>{}</td><td>{:.1}</td><td>{:.2}</td></tr>",
                    link.from,
                    link.to,
                    if link.closure { "closure" } else { "link" },
                    measured.translation.length(),
                    link.frames,
                    off.translation.length() * 1e3,
                    off.angle().to_degrees()
                )
            })
            .collect();
        let mut note = format!("{} submaps, {} keyframes.", self.submaps.len(), self.keyframes.len());
        if let (Some(live), Some(last)) = (&self.summary.live_evaluation, &self.summary.evaluation) {
            let [live, last] = [live, last].map(|e| e.ate.rmse * 1e3);
            note += &format!(" ATE {last:.1} mm rmse; {live:.1} mm with the poses as they were found.");
        }
        format!(
            "<p class='note'>{note}</p><div class='columns'><figure>{names}{svg}<figcaption>From above</figcaption>\
             </figure><table><tr><th>submaps</th><th></th><th>apart (m)</th><th>frames</th><th>off (mm)</th>\
             <th>off (°)</th></tr>{rows}</table></div>\
             <p class='note'>Off: how far the submaps lie from what the link measured, after optimisation.</p>"
        )
    }

    fn position_error(&self, errors: &[(itm_core::Timestamp, f64)]) -> String {
        let Some(top) = errors.iter().map(|(_, e)| *e).max_by(f64::total_cmp) else { return String::new() };
        let of_row = |row: &Row| {
            let at = errors.binary_search_by_key(&row.timestamp?, |(timestamp, _)| *timestamp).ok()?;
            Some(errors[at].1)
        };
        let values = self.rows.iter().map(of_row).collect();
        let line = Layer { name: String::new(), class: "error".into(), values };
        let bands = self.bands();
        let svg = plot::over_frames(&OverFrames {
            first: self.first_frame(),
            stacked: &[],
            lines: &[line],
            bands: &bands,
            strip: &[],
            name: "position error (mm)",
            top: (top * 1.1).max(0.1),
            height: 200.0,
        });
        let figure = format!("<figure style='margin:14px 0 0'>{svg}");
        format!("{figure}<figcaption>Distance to the true position after alignment</figcaption></figure>")
    }

    fn first_frame(&self) -> u64 {
        self.rows.first().map_or(0, |row| row.frame)
    }

    /// Runs of frames that were not good.
    fn bands(&self) -> Vec<(&'static str, usize, usize)> {
        self.runs(|row| match row.status {
            "lost" => Some("lost"),
            "poor" => Some("poor"),
            "skipped" | "no-pose" | "no-depth" => Some("skipped"),
            _ => None,
        })
    }

    /// Runs of neighbouring frames of one class: class, first frame, number of frames (by their place, from 0).
    fn runs(&self, class: impl Fn(&Row) -> Option<&'static str>) -> Vec<(&'static str, usize, usize)> {
        let mut runs: Vec<(&'static str, usize, usize)> = Vec::new();
        for (i, row) in self.rows.iter().enumerate() {
            let Some(class) = class(row) else { continue };
            match runs.last_mut() {
                Some((last, start, length)) if *last == class && *start + *length == i => *length += 1,
                _ => runs.push((class, i, 1)),
            }
        }
        runs
    }

    fn tracking(&self) -> String {
        if self.rows.iter().all(|row| row.verdict.is_none()) {
            return self.not_good();
        }
        let bands = self.bands();
        let strip = self.runs(|row| row.verdict);
        let mut names = Vec::new();
        for (class, name) in [("good", "good"), ("poor", "poor"), ("lost", "lost")] {
            let count = self.rows.iter().filter(|row| row.verdict == Some(class)).count();
            names.push((format!("verdict {class}"), format!("{name}: {}", grouped(count))));
        }
        if bands.iter().any(|band| band.0 == "skipped") {
            names.push(("skipped".into(), "skipped, or without a pose or depth".into()));
        }
        let draw = |stacked: &[Layer], lines: &[Layer], name: &str, top: f64| {
            let (first, height) = (self.first_frame(), 170.0);
            plot::over_frames(&OverFrames { first, stacked, lines, bands: &bands, strip: &strip, name, top, height })
        };
        let line = |name: &str, value: &dyn Fn(&Row) -> Option<f64>, top: Option<f64>, caption: &str| {
            let values: Vec<Option<f64>> = self.rows.iter().map(value).collect();
            let (found, beyond) = top_of(values.iter().flatten().copied().collect());
            let layer = Layer { name: String::new(), class: "error".into(), values };
            let svg = draw(&[], &[layer], name, top.unwrap_or(found));
            let beyond = beyond.filter(|_| top.is_none()).unwrap_or_default();
            format!("<figure class='row'>{svg}<figcaption>{caption}{beyond}</figcaption></figure>")
        };
        let mut body = legend(names.iter().map(|(class, name)| (class.as_str(), name.as_str())));
        body += &line(
            "inliers (%)",
            &|row| row.inlier_share.map(|share| 100.0 * share),
            Some(100.0),
            "Points that agree with the map, as a share of the pixels with a depth",
        );
        body +=
            &line("residual (mm)", &|row| row.rms_mm, None, "Distance of those points from the map, root mean square");
        let levels = self.rows.iter().map(|row| row.iterations.len()).max().unwrap_or(0);
        // Counted from the finest level, as rows may have different numbers of them.
        let of_level = |row: &Row, level: usize| Some(*row.iterations.iter().rev().nth(level)?);
        let layers: Vec<Layer> = (0..levels)
            .rev()
            .map(|level| Layer {
                name: match level {
                    0 => "finest level".into(),
                    _ if level + 1 == levels => "coarsest level".into(),
                    _ => format!("level {level}"),
                },
                class: format!("l{}", level.min(7)),
                values: self.rows.iter().map(|row| of_level(row, level).map(f64::from)).collect(),
            })
            .collect();
        if !layers.is_empty() {
            let sums = self.rows.iter().map(|row| f64::from(row.iterations.iter().sum::<u32>()));
            let (top, beyond) = top_of(sums.collect());
            let svg = draw(&layers, &[], "iterations", top);
            let names = legend(layers.iter().map(|l| (l.class.as_str(), l.name.as_str())));
            let caption = format!("Iterations at each level of the image pyramid{}", beyond.unwrap_or_default());
            body += &format!("<figure class='row'>{names}{svg}<figcaption>{caption}</figcaption></figure>");
        }
        body += &line(
            "chance wrong",
            &|row| row.chance_wrong,
            Some(1.0),
            "Estimated chance that the pose is wrong; 0 or 1 where a frame was judged otherwise",
        );
        body + &self.not_good()
    }

    /// The frames that were not good, and why.
    fn not_good(&self) -> String {
        // Neighbours that are alike in everything share a line.
        let mut groups: Vec<(&Row, &Row)> = Vec::new();
        let mut before = None;
        for (i, row) in self.rows.iter().enumerate().filter(|(_, row)| row.trouble().is_some()) {
            let follows = i > 0 && before == Some(i - 1);
            before = Some(i);
            match groups.last_mut() {
                Some((first, last)) if follows && first.status == row.status && first.reasons == row.reasons => {
                    *last = row
                }
                _ => groups.push((row, row)),
            }
        }
        if groups.is_empty() {
            return String::new();
        }
        let line = |(row, last): &(&Row, &Row)| {
            let class = row.verdict.map_or_else(|| "skipped".into(), |verdict| format!("verdict {verdict}"));
            let mark = format!("<i class='mark {class}'></i>{}", row.status.replace('-', " "));
            let frames = match (row.frame, last.frame) {
                (first, last) if first == last => format!("frame {first}"),
                (first, last) => format!("frames {first} to {last}"),
            };
            format!("<tr><th>{frames}</th><td class='verdict'>{mark}</td><td>{}</td></tr>", escape(&row.why()))
        };
        let lines: String = groups.iter().take(MOST_NOT_GOOD).map(line).collect();
        let more = match groups.len().saturating_sub(MOST_NOT_GOOD) {
            0 => String::new(),
            more => format!("<p class='note'>and {} more lines; timings.csv has all frames</p>", grouped(more)),
        };
        format!("<h3>Frames that were not good</h3><table class='frames'>{lines}</table>{more}")
    }

    fn timings(&self) -> String {
        let totals: Vec<f64> = self.rows.iter().filter_map(|row| row.total_ms).collect();
        if totals.is_empty() {
            return String::new();
        }
        let stage = |(i, name): (usize, &&str)| Layer {
            name: name.to_string(),
            class: format!("s{i}"),
            values: self.rows.iter().map(|row| row.stage_ms[i]).collect(),
        };
        let stacked: Vec<Layer> = STAGES.iter().enumerate().map(stage).collect();
        let stacked: Vec<Layer> = stacked.into_iter().filter(|l| l.values.iter().any(Option::is_some)).collect();
        let total = Layer {
            name: "whole frame".into(),
            class: "total".into(),
            values: self.rows.iter().map(|row| row.total_ms).collect(),
        };
        let sum = |row: &Row| row.stage_ms.iter().flatten().sum::<f64>().max(row.total_ms.unwrap_or(0.0));
        let heights: Vec<f64> = self.rows.iter().map(sum).collect();
        let (top, beyond) = top_of(heights);
        let bands = self.bands();
        let lines = [total];
        let svg = plot::over_frames(&OverFrames {
            first: self.first_frame(),
            stacked: &stacked,
            lines: &lines,
            bands: &bands,
            strip: &[],
            name: "time (ms)",
            top,
            height: 340.0,
        });
        let mut names: Vec<(&str, &str)> = stacked.iter().map(|l| (l.class.as_str(), l.name.as_str())).collect();
        names.push(("total thin", "whole frame"));
        for (class, name) in [("poor", "poor"), ("lost", "lost"), ("skipped", "skipped, or without a pose or depth")] {
            if bands.iter().any(|band| band.0 == class) {
                names.push((class, name));
            }
        }
        let mut note = "Stages as measured on the device, tracking and the whole frame on the host".to_string();
        if stacked.len() < 2 {
            note = "This device has no clock, so that its stages are not timed".into();
        }
        if let Some(beyond) = beyond {
            note += &format!("{beyond}.");
        }
        format!("{}{svg}<p class='note'>{note}</p>{}", legend(names), self.stage_table())
    }

    /// What the surfels take, by their number: the time of the stages over them, and their memory.
    fn surfels(&self) -> String {
        const BINS: usize = 24;
        let of_surfels = |row: &Row| {
            let stages = STAGES.iter().zip(&row.stage_ms);
            let known: Vec<f64> =
                stages.filter(|(name, _)| OVER_SURFELS.contains(name)).filter_map(|(_, ms)| *ms).collect();
            let surfels = row.surfels.filter(|_| known.len() >= 3)?;
            Some(DVec2::new(f64::from(surfels) * 1e-6, known.iter().sum()))
        };
        let frames: Vec<DVec2> = self.rows.iter().filter_map(of_surfels).collect();
        let most = frames.iter().map(|frame| frame.x).fold(0.0, f64::max);
        if most <= 0.0 {
            return String::new();
        }
        let bin = |i: usize| {
            let within = |x: f64| ((x / most * BINS as f64) as usize).min(BINS - 1) == i;
            let here: Vec<f64> = frames.iter().filter(|frame| within(frame.x)).map(|frame| frame.y).collect();
            median(here).map(|ms| DVec2::new((i as f64 + 0.5) / BINS as f64 * most, ms))
        };
        let mib = bytes_per_surfel() as f64 / f64::from(1 << 20) * 1e6;
        let curve = |name, class, points| Curve { name, class, points, ends: false };
        let time = curve("time", "error", (0..BINS).filter_map(bin).collect());
        let memory = curve("memory", "keyframe", vec![DVec2::ZERO, DVec2::new(most, most * mib)]);
        format!(
            "{}{}<p class='note'>Median time of the stages over surfels ({}) by the number of surfels in the map, in view or not; and what \
             the surfels take of the device's memory, {} bytes each. Pools grow by a quarter at a time.</p>",
            plot::over(&[time], ["surfels in the map (millions)", "time (ms)"], 240.0),
            plot::over(&[memory], ["surfels in the map (millions)", "memory (MiB)"], 180.0),
            OVER_SURFELS.join(", "),
            bytes_per_surfel(),
        )
    }

    fn stage_table(&self) -> String {
        let row = |name: &str, values: Vec<f64>| {
            let (Some(middle), Some(largest)) = (median(values.clone()), values.iter().copied().max_by(f64::total_cmp))
            else {
                return String::new();
            };
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let cells: String =
                [middle, mean, largest].iter().map(|v| format!("<td class='number'>{v:.2}</td>")).collect();
            format!("<tr><th>{name}</th>{cells}<td class='number'>{}</td></tr>", values.len())
        };
        let stages = STAGES.iter().enumerate();
        let mut rows: String =
            stages.map(|(i, name)| row(name, self.rows.iter().filter_map(|r| r.stage_ms[i]).collect())).collect();
        rows += &row("whole frame", self.rows.iter().filter_map(|r| r.total_ms).collect());
        let head = ["median (ms)", "mean (ms)", "largest (ms)", "frames"];
        let head: String = head.iter().map(|h| format!("<th style='text-align:right'>{h}</th>")).collect();
        format!("<table><tr><th>stage</th>{head}</tr>{rows}</table>")
    }

    fn table(&self) -> String {
        let s = self.summary;
        let c = &self.info.calibration;
        let camera = |i: &itm_core::Intrinsics| {
            format!("{}×{}, f {:.2} {:.2}, c {:.2} {:.2} px", i.width, i.height, i.fx, i.fy, i.cx, i.cy)
        };
        let mut rows = vec![
            ("recording", format!("{} ({})", s.recording, s.format)),
            ("calibration", s.calibration.clone()),
            ("depth camera", camera(&c.depth)),
        ];
        if self.info.has_colour {
            rows.push(("colour camera", camera(&c.colour)));
        }
        rows.push(("device", s.device.clone()));
        let (reached, share) = (grouped(s.frames_reached), s.posed_share * 100.0);
        let posed = format!("{} of {reached} with a pose ({share:.1} %)", grouped(s.posed));
        rows.push(("frames", format!("{posed}, {} poor, {} lost, {} skipped", s.poor, s.lost, s.skipped)));
        if self.info.depth_without_colour > 0 {
            let left_out = format!("{} depth images without a colour image", self.info.depth_without_colour);
            rows.push(("left out", left_out));
        }
        let rate = format!("{:.1} s, {:.1} frames/s", s.seconds, s.frames_per_second);
        rows.push(("time", rate));
        if let Some(e) = &s.evaluation {
            let ate = format!(
                "rmse {:.2} mm, median {:.2} mm, largest {:.2} mm; {} poses, path of {:.2} m",
                e.ate.rmse * 1e3,
                e.ate.median * 1e3,
                e.ate.max * 1e3,
                e.pairs,
                e.path_length_m
            );
            rows.push(("trajectory error", ate));
            let (mm, degrees) = (e.rpe_translation.rmse * 1e3, e.rpe_rotation.rmse.to_degrees());
            rows.push(("relative error", format!("rmse {mm:.2} mm and {degrees:.3}° from frame to frame")));
        }
        if let Some(e) = &s.mesh_error {
            let error = format!(
                "median {:.2} mm, 99th percentile {:.2} mm, {:.1} % within a voxel; {} vertices",
                e.median_mm,
                e.percentile_99_mm,
                e.within_voxel * 100.0,
                grouped(e.vertices)
            );
            rows.push(("surface error", error));
        }
        if let Some(surfels) = s.surfels {
            rows.push((
                "map",
                format!("{} surfels, {} MiB on the device", grouped(surfels as usize), s.map_bytes >> 20),
            ));
        }
        if let Some(blocks) = s.blocks {
            rows.push(("map", format!("{} blocks, {} MiB on the device", grouped(blocks as usize), s.map_bytes >> 20)));
        }
        if let Some(mesh) = &s.mesh {
            let (vertices, triangles) = (grouped(mesh.vertices), grouped(mesh.triangles));
            rows.push(("mesh", format!("{vertices} vertices, {triangles} triangles, made in {:.1} s", mesh.seconds)));
        }
        let row = |(name, value): (&str, String)| format!("<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
        format!("<table>{}</table>", rows.into_iter().map(row).collect::<String>())
    }

    fn messages(&self) -> String {
        let messages = &self.summary.messages;
        if messages.is_empty() {
            return String::new();
        }
        let row =
            |m: &crate::summary::Message| format!("<tr><th>frame {}</th><td>{}</td></tr>", m.frame, escape(&m.text));
        let rows: String = messages.iter().take(MOST_MESSAGES).map(row).collect();
        let more = messages.len().saturating_sub(MOST_MESSAGES);
        let note = if more > 0 { format!("<p class='note'>and {more} more</p>") } else { String::new() };
        format!("<table>{rows}</table>{note}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_the_page() {
        assert_eq!(escape("<b>'a' & \"b\"</b>"), "&lt;b&gt;&#39;a&#39; &amp; &quot;b&quot;&lt;/b&gt;");
    }

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(grouped(12), "12");
        assert_eq!(grouped(1_234_567), "1\u{202f}234\u{202f}567");
    }
}
