//! `timings.csv`: a row for each frame, a column for each stage.

use std::collections::VecDeque;
use std::io::{self, Write};

use itm_slam::{FrameReport, FrameResult, FrameStatus, Timestamp};

/// The stages in the order of the pipeline. `track` is measured on the host, waits included, the others on the device.
pub(crate) const STAGES: [&str; 17] = [
    "view",
    "shrink",
    "track",
    "hash",
    "swap",
    "allocate",
    "visible",
    "integrate",
    "ranges",
    "forward",
    "raycast",
    "normals",
    "confidence",
    "associate",
    "segment",
    "absorb",
    "splat",
];

/// Its place among them.
const TRACK: usize = 2;

/// Rows are handed to the operating system after so many frames.
const FLUSH_EVERY: usize = 30;

/// What became of a frame, and what it took. `None` where it is not known or did not happen.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Row {
    pub(crate) frame: u64,
    pub(crate) timestamp: Option<Timestamp>,
    /// `placed`, `tracked`, `lost`, `no-pose` or `skipped`.
    pub(crate) status: &'static str,
    /// Milliseconds of each of [`STAGES`].
    pub(crate) stage_ms: [Option<f64>; STAGES.len()],
    /// Milliseconds from taking the decoded frame to the end of its processing on the host.
    pub(crate) total_ms: Option<f64>,
    pub(crate) visible_blocks: Option<u32>,
    /// Blocks in use.
    pub(crate) blocks: Option<u32>,
    /// Surfels, those that may be removed included.
    pub(crate) surfels: Option<u32>,
    pub(crate) inliers: Option<u32>,
    pub(crate) inlier_share: Option<f64>,
    pub(crate) rms_mm: Option<f64>,
    /// `good`, `poor` or `lost`, where the frame was tracked.
    pub(crate) verdict: Option<&'static str>,
    pub(crate) chance_wrong: Option<f64>,
    pub(crate) information: Option<f64>,
    /// Directions that were held.
    pub(crate) held: Option<usize>,
    /// At each level, from coarse to fine.
    pub(crate) iterations: Vec<u32>,
    /// Why the frame was not good.
    pub(crate) reasons: Vec<String>,
}

impl Row {
    /// What became of the frame, where that is not what one hopes for.
    pub(crate) fn trouble(&self) -> Option<&'static str> {
        (!matches!(self.status, "placed" | "tracked")).then_some(self.status)
    }

    /// The reasons in one text.
    pub(crate) fn why(&self) -> String {
        self.reasons.join("; ")
    }
}

/// Writes rows in the order of the frames, each once its report has come.
///
/// Reports come two frames late, so few rows ever wait.
pub(crate) struct Timings<W: Write> {
    writer: W,
    rows: Vec<Row>,
    /// Number of rows written.
    written: usize,
    /// Places in `rows` of those whose report is due, in order.
    due: VecDeque<usize>,
    unflushed: usize,
}

impl<W: Write> Timings<W> {
    pub(crate) fn new(mut writer: W) -> io::Result<Self> {
        let stages = STAGES.join(",");
        writeln!(
            writer,
            "frame,timestamp,status,{stages},total_ms,visible_blocks,blocks,surfels,inliers,inlier_share,rms_mm,verdict,\
             chance_wrong,information,held,iterations,reasons"
        )?;
        writer.flush()?;
        Ok(Self { writer, rows: Vec::new(), written: 0, due: VecDeque::new(), unflushed: 0 })
    }

    /// All rows so far.
    pub(crate) fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Takes in a frame that was processed.
    pub(crate) fn frame(&mut self, result: &FrameResult, total_ms: f64) -> io::Result<()> {
        let mut row = Row {
            frame: result.index,
            timestamp: Some(result.timestamp),
            status: match result.status {
                FrameStatus::Placed => "placed",
                FrameStatus::Tracked => "tracked",
                FrameStatus::Poor { .. } => "poor",
                FrameStatus::Lost { .. } => "lost",
                FrameStatus::NoPose => "no-pose",
                FrameStatus::NoDepth => "no-depth",
            },
            verdict: match result.status {
                FrameStatus::Tracked => Some("good"),
                FrameStatus::Poor { .. } => Some("poor"),
                FrameStatus::Lost { .. } => Some("lost"),
                _ => None,
            },
            reasons: match &result.status {
                FrameStatus::Poor { reason } | FrameStatus::Lost { reason } => {
                    let told = result.tracked.as_ref().map(|tracked| tracked.reasons.clone());
                    told.filter(|reasons| !reasons.is_empty()).unwrap_or_else(|| vec![reason.clone()])
                }
                FrameStatus::NoPose => vec!["there is no given pose".into()],
                FrameStatus::NoDepth => vec!["no pixel has a depth within the view's range".into()],
                FrameStatus::Placed | FrameStatus::Tracked => Vec::new(),
            },
            total_ms: Some(total_ms),
            ..Row::default()
        };
        if let Some(tracked) = &result.tracked {
            row.stage_ms[TRACK] = Some(result.track_ms);
            row.inliers = Some(tracked.inliers);
            row.inlier_share = Some(tracked.inlier_share);
            // Without inliers it is infinite.
            row.rms_mm = Some(tracked.rms_m * 1e3).filter(|rms| rms.is_finite());
            row.chance_wrong = Some(tracked.chance_wrong);
            row.information = Some(tracked.information);
            row.held = Some(tracked.held);
            row.iterations.clone_from(&tracked.evaluations);
        }
        if result.fused {
            self.due.push_back(self.rows.len());
        }
        self.rows.push(row);
        if let Some(report) = &result.report {
            self.take(report);
        }
        self.write_complete()
    }

    /// Takes in a frame that was skipped.
    pub(crate) fn skipped(&mut self, index: usize, reason: &str) -> io::Result<()> {
        let reasons = vec![reason.to_string()];
        self.rows.push(Row { frame: index as u64, status: "skipped", reasons, ..Row::default() });
        self.write_complete()
    }

    /// Takes in the last reports, and writes all rows whether their report has come or not.
    pub(crate) fn finish(&mut self, reports: &[FrameReport]) -> io::Result<()> {
        for report in reports {
            self.take(report);
        }
        self.due.clear();
        self.write_complete()?;
        self.writer.flush()
    }

    fn take(&mut self, report: &FrameReport) {
        let Some(place) = self.due.iter().position(|&row| self.rows[row].frame == report.index) else {
            tracing::warn!("frame {} was reported, but is not waited for", report.index);
            return;
        };
        // An earlier frame whose report did not come will not get one any more.
        let row = self.due.drain(..=place).next_back().expect("the range holds the place that was found");
        let row = &mut self.rows[row];
        for (name, ms) in &report.stage_ms {
            match STAGES.iter().position(|stage| stage == name) {
                Some(stage) => *row.stage_ms[stage].get_or_insert(0.0) += ms,
                None => tracing::warn!("the stage '{name}' has no column in the timings"),
            }
        }
        match &report.surfels {
            Some(record) => row.surfels = Some(record.used.saturating_sub(record.free)),
            None => {
                row.visible_blocks = Some(report.record.visible);
                row.blocks = Some(report.record.blocks.saturating_sub(report.record.free_blocks));
            }
        }
    }

    fn write_complete(&mut self) -> io::Result<()> {
        let end = self.due.front().copied().unwrap_or(self.rows.len());
        for row in &self.rows[self.written..end] {
            row.write(&mut self.writer)?;
        }
        self.unflushed += end - self.written;
        self.written = end;
        if self.unflushed >= FLUSH_EVERY {
            self.unflushed = 0;
            self.writer.flush()?;
        }
        Ok(())
    }
}

impl Row {
    fn write(&self, to: &mut impl Write) -> io::Result<()> {
        fn cell<T: std::fmt::Display>(value: Option<T>) -> String {
            value.map_or_else(String::new, |v| v.to_string())
        }
        let ms = |value: Option<f64>| cell(value.map(|v| format!("{v:.4}")));
        write!(to, "{},{},{}", self.frame, cell(self.timestamp), self.status)?;
        for value in self.stage_ms.into_iter().chain([self.total_ms]) {
            write!(to, ",{}", ms(value))?;
        }
        let (visible, blocks, surfels) = (cell(self.visible_blocks), cell(self.blocks), cell(self.surfels));
        let inliers = cell(self.inliers);
        write!(to, ",{visible},{blocks},{surfels},{inliers},{},{}", ms(self.inlier_share), ms(self.rms_mm))?;
        let information = cell(self.information.map(|v| format!("{v:.6}")));
        write!(to, ",{},{},{information},{}", cell(self.verdict), ms(self.chance_wrong), cell(self.held))?;
        let iterations: Vec<String> = self.iterations.iter().map(u32::to_string).collect();
        writeln!(to, ",{},{}", iterations.join("/"), quoted(&self.why()))
    }
}

/// A text as a CSV cell in one line (RFC 4180).
fn quoted(text: &str) -> String {
    if text.is_empty() {
        return String::new();
    }
    format!("\"{}\"", text.replace(['\n', '\r'], " ").replace('"', "\"\""))
}

/// The middle one of some values, or `None` of none.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use itm_slam::tracking::{Tracked, Verdict};
    use itm_slam::{FrameRecord, Se3};

    fn result(index: u64, status: FrameStatus, report: Option<FrameReport>) -> FrameResult {
        let posed = matches!(status, FrameStatus::Placed | FrameStatus::Tracked);
        FrameResult {
            index,
            timestamp: Timestamp(index as i64 * 500_000_000),
            world_from_camera: posed.then_some(Se3::IDENTITY),
            submap: 0,
            status,
            tracked: None,
            fused: posed,
            track_ms: 0.0,
            happenings: Vec::new(),
            report,
        }
    }

    #[test]
    fn tracking_has_its_place() {
        assert_eq!(STAGES[TRACK], "track");
    }

    fn report(index: u64) -> Option<FrameReport> {
        let record = FrameRecord { blocks: 30, free_blocks: 10, visible: 7, ..FrameRecord::default() };
        Some(FrameReport {
            index,
            record,
            surfels: None,
            stage_ms: vec![("view", 1.5), ("raycast", 2.0)],
            notices: Vec::new(),
        })
    }

    fn lost() -> FrameStatus {
        FrameStatus::Lost { reason: "too few".into() }
    }

    fn lines(timings: &Timings<Vec<u8>>) -> Vec<String> {
        String::from_utf8(timings.writer.clone()).unwrap().lines().skip(1).map(String::from).collect()
    }

    #[test]
    fn rows_wait_for_their_reports_and_keep_their_order() {
        let mut timings = Timings::new(Vec::new()).unwrap();
        timings.frame(&result(4, FrameStatus::Placed, None), 10.0).unwrap();
        timings.skipped(5, "cut off").unwrap();
        timings.frame(&result(6, lost(), None), 11.0).unwrap();
        assert!(lines(&timings).is_empty());
        timings.frame(&result(7, FrameStatus::Tracked, report(4)), 12.0).unwrap();
        let expected = [
            "4,2.000000000,placed,1.5000,,,,,,,,,,2.0000,,,,,,,10.0000,7,20,,,,,,,,,,",
            "5,,skipped,,,,,,,,,,,,,,,,,,,,,,,,,,,,,,\"cut off\"",
            "6,3.000000000,lost,,,,,,,,,,,,,,,,,,11.0000,,,,,,,lost,,,,,\"too few\"",
        ];
        assert_eq!(lines(&timings), expected);
        timings.finish(&[report(7).unwrap()]).unwrap();
        assert_eq!(lines(&timings)[3], "7,3.500000000,tracked,1.5000,,,,,,,,,,2.0000,,,,,,,12.0000,7,20,,,,,good,,,,,");
        let header = String::from_utf8(timings.writer.clone()).unwrap();
        let columns = header.lines().next().unwrap().split(',').count();
        assert!(lines(&timings).iter().all(|line| line.split(',').count() == columns), "{header}");
    }

    #[test]
    fn what_tracking_found_is_in_the_row_and_reasons_are_one_cell() {
        let mut timings = Timings::new(Vec::new()).unwrap();
        let tracked = Tracked {
            covariance: Default::default(),
            features: None,
            world_from_camera: Se3::IDENTITY,
            estimate: Se3::IDENTITY,
            verdict: Verdict::Poor,
            reasons: vec!["12 %, of 900".into(), "the \"plane\"\nslides".into()],
            chance_wrong: 0.625,
            inliers: 108,
            inlier_share: 0.12,
            rms_m: 0.004,
            information: 2e-4,
            held: 2,
            start: 0,
            evaluations: vec![5, 3, 0, 2],
        };
        let status = FrameStatus::Poor { reason: tracked.reasons.join("; ") };
        let result = FrameResult { tracked: Some(tracked), fused: false, ..result(3, status, None) };
        timings.frame(&result, 9.0).unwrap();
        let cells = "poor,0.6250,0.000200,2,5/3/0/2,\"12 %, of 900; the \"\"plane\"\" slides\"";
        let expected = format!("3,1.500000000,poor,,,0.0000,,,,,,,,,,,,,,,9.0000,,,,108,0.1200,4.0000,{cells}");
        assert_eq!(lines(&timings), [expected]);
        assert_eq!(timings.rows()[0].trouble(), Some("poor"));
    }

    #[test]
    fn rows_whose_report_never_comes_are_written_at_the_end() {
        let mut timings = Timings::new(Vec::new()).unwrap();
        for i in 0..3 {
            timings.frame(&result(i, FrameStatus::Placed, None), 1.0).unwrap();
        }
        timings.finish(&report(1).into_iter().collect::<Vec<_>>()).unwrap();
        let frames: Vec<_> = lines(&timings).iter().map(|l| l.split(',').next().unwrap().to_string()).collect();
        assert_eq!(frames, ["0", "1", "2"]);
    }

    #[test]
    fn a_full_disk_is_an_error() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        assert!(Timings::new(Full).is_err());
    }

    #[test]
    fn medians() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0]), Some(2.5));
        assert_eq!(median([]), None);
    }
}
