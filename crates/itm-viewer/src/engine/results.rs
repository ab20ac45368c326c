//! What a run wrote into its folder.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use itm_slam::{Mesh, Settings, StampedPose};

use super::state::{Row, Verdict};

/// A run's results, as far as they are there.
#[derive(Debug, Default)]
pub(super) struct Results {
    pub(super) name: String,
    /// In words.
    pub(super) about: String,
    pub(super) mesh: Option<Mesh>,
    /// The corners of the box around it, once that is asked for.
    pub(super) bounds: Option<(Vec3, Vec3)>,
    pub(super) trajectory: Vec<StampedPose>,
    pub(super) rows: Vec<Row>,
    pub(super) settings: Settings,
    /// What could not be read, and why.
    pub(super) warnings: Vec<String>,
}

/// Columns of timings.csv around those of the stages.
const BEFORE_STAGES: &str = "status";
const AFTER_STAGES: &str = "total_ms";

impl Results {
    /// Reads a folder, or that of a report in it.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let folder = if path.is_dir() { path.to_owned() } else { path.parent().unwrap_or(Path::new("")).to_owned() };
        let name =
            folder.canonicalize().ok().and_then(|folder| Some(folder.file_name()?.to_string_lossy().into_owned()));
        let mut results = Self { name: name.unwrap_or_else(|| folder.display().to_string()), ..Self::default() };
        let there = |name: &str| Some(folder.join(name)).filter(|path| path.is_file());
        if let Some(path) = there("settings.toml") {
            let parsed = fs::read_to_string(&path).map_err(|error| error.to_string()).and_then(|text| {
                Settings::resolve(Some((&path.display().to_string(), &text)), &[]).map_err(|error| error.to_string())
            });
            results.settings = results.or_warn(parsed).unwrap_or_default();
        }
        if let Some(path) = there("trajectory.txt") {
            let read = itm_io::trajectory::read_tum(&path).map_err(|error| error.to_string());
            results.trajectory = results.or_warn(read).map(|read| read.poses().to_vec()).unwrap_or_default();
        }
        if let Some(path) = there("timings.csv") {
            let read = fs::read_to_string(&path).map_err(|error| format!("cannot read '{}': {error}", path.display()));
            results.rows = results.or_warn(read).map(|text| rows(&text)).unwrap_or_default();
        }
        results.read_mesh(there("mesh.ply"));
        if results.mesh.is_none() && results.trajectory.is_empty() {
            let warnings = results.warnings.join("; ");
            return Err(format!("'{}' holds no mesh and no trajectory that can be shown{warnings}", folder.display()));
        }
        let triangles = results.mesh.as_ref().map_or(0, |mesh| mesh.triangles.len());
        let (poses, mode) = (results.trajectory.len(), results.settings.mode.name());
        results.about = format!("what a run of mode {mode} wrote: a mesh of {triangles} triangles, {poses} poses");
        Ok(results)
    }

    fn read_mesh(&mut self, path: Option<PathBuf>) {
        let Some(path) = path else { return };
        let read = itm_io::mesh::read(&path).map_err(|error| error.to_string());
        self.mesh = self.or_warn(read);
    }

    fn or_warn<T>(&mut self, result: Result<T, String>) -> Option<T> {
        result.map_err(|reason| self.warnings.push(reason)).ok()
    }
}

/// The rows of timings.csv; what is no number is not known.
fn rows(text: &str) -> Vec<Row> {
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| columns.iter().position(|column| *column == name);
    let stages = match (column(BEFORE_STAGES), column(AFTER_STAGES)) {
        (Some(before), Some(after)) if before < after => before + 1..after,
        _ => 0..0,
    };
    let row = |line: &str| {
        // Reasons stand in the last column, which may hold commas: those before it do not.
        let fields: Vec<&str> = line.split(',').collect();
        let number = |name: &str| column(name).and_then(|i| fields.get(i)?.parse::<f64>().ok());
        let text = |name: &str| column(name).and_then(|i| fields.get(i).copied()).unwrap_or_default();
        Some(Row {
            frame: number("frame")? as u64,
            total_ms: number("total_ms"),
            stages_ms: stages
                .clone()
                .filter_map(|i| Some((Cow::Owned((*columns.get(i)?).to_owned()), fields.get(i)?.parse().ok()?)))
                .collect(),
            size: number("surfels").or_else(|| number("blocks")).map(|size| size as u32),
            map_mib: None,
            residual_mm: number("rms_mm"),
            verdict: match text("verdict") {
                "good" => Some(Verdict::Good),
                "poor" => Some(Verdict::Poor),
                "lost" => Some(Verdict::Lost),
                _ => None,
            },
        })
    };
    lines.filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_what_is_there() {
        let text = "frame,timestamp,status,view,track,total_ms,blocks,surfels,rms_mm,verdict,reasons\n\
                    0,0.1,placed,1.5,,20,100,,,,\n\
                    1,0.2,poor,2,7.25,30.5,120,,1.25,poor,\"few inliers, and more\"\n\
                    nonsense\n";
        let rows = rows(text);
        assert_eq!(rows.len(), 2);
        assert_eq!((rows[0].frame, rows[0].total_ms, rows[0].size), (0, Some(20.0), Some(100)));
        assert_eq!(rows[0].stages_ms, [("view".into(), 1.5)]);
        assert_eq!(rows[1].stages_ms, [("view".into(), 2.0), ("track".into(), 7.25)]);
        assert_eq!((rows[1].verdict, rows[1].residual_mm), (Some(Verdict::Poor), Some(1.25)));
        assert!(super::rows("").is_empty());
    }

    #[test]
    fn a_folder_without_anything_to_show_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("settings.toml"), "no settings").unwrap();
        let error = Results::read(folder.path()).unwrap_err();
        assert!(error.contains("no mesh and no trajectory"), "{error}");
        // What cannot be read is left out, and said.
        fs::write(folder.path().join("trajectory.txt"), "1 0 0 0 0 0 0 1\n").unwrap();
        let results = Results::read(folder.path()).unwrap();
        assert_eq!((results.trajectory.len(), results.warnings.len()), (1, 1));
    }
}
