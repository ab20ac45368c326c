//! `accuracy`: every tracker and every extension on the same recordings, as the tables of `docs/ACCURACY.md`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

use crate::setup::{self, Installing, cargo};
use crate::{steps, workspace_root};

/// Frames of each recording with `--quick`.
const QUICK_FRAMES: u64 = 60;
/// Between these lines the page is this command's own.
const BEGIN: &str = "<!-- accuracy: begin -->";
const END: &str = "<!-- accuracy: end -->";

/// The synthetic recordings: name, and what `itm synth` is given.
const SYNTHETIC: [(&str, &[&str]); 5] = [
    ("arc", &["--path", "arc"]),
    ("loop", &["--path", "loop"]),
    ("fast", &["--path", "fast"]),
    ("blank wall", &["--path", "wall", "--scene", "blank-wall"]),
    (EXPOSURE, &["--path", "arc", "--exposure", "auto"]),
];

/// The one that is there for the extension `estimate_exposure` alone.
const EXPOSURE: &str = "arc, exposure";

/// The trackers with their defaults, and whether they need an inertial sensor.
const TRACKERS: [(&str, bool); 6] = [
    ("icp", false),
    ("extended", false),
    ("rgb", false),
    ("imuicp", true),
    ("extendedimu", true),
    ("composite", false),
];

/// The default tracker's extensions: the setting, and what is switched on with it so that it matters.
const EXTENSIONS: [(&str, &[&str]); 6] = [
    ("tracker.predict_motion", &[]),
    ("tracker.hold_degenerate", &[]),
    ("tracker.extended.use_map_colour", &[]),
    ("tracker.extended.use_colour", &[]),
    ("tracker.extended.estimate_exposure", &["tracker.extended.use_colour", "tracker.extended.use_map_colour"]),
    ("view.colour_times", &["tracker.extended.use_colour"]),
];

/// A recording to run.
struct Recording {
    name: String,
    folder: PathBuf,
    frames: u64,
    gyroscope: bool,
    /// The settings that a run has without any given, as TOML.
    defaults: String,
}

/// A difference from the default settings.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Difference {
    key: String,
    value: String,
}

/// Where things lie, and what was measured.
struct Workplace<'a> {
    itm: PathBuf,
    runs: PathBuf,
    quick: bool,
    /// Names of the recordings that are run; all where there are none.
    only: &'a [String],
    device: String,
    /// Rows by recording and differences, so that nothing is measured twice.
    measured: BTreeMap<(String, Vec<Difference>), Vec<String>>,
}

/// Builds the program, makes the synthetic recordings, runs everything, and writes the tables.
pub(crate) fn accuracy(installing: Installing, data: Option<&Path>, quick: bool, only: &[String]) -> Result<()> {
    setup::adapter(installing)?;
    let folder = workspace_root().join("target/accuracy");
    let runs = folder.join("runs");
    steps::run(cargo().args(["build", "--release", "--package", "itm-cli"]))?;
    let itm = program()?;
    if runs.exists() {
        std::fs::remove_dir_all(&runs).with_context(|| format!("can't remove {}", runs.display()))?;
    }
    let mut place = Workplace { itm, runs, quick, only, device: String::new(), measured: BTreeMap::new() };

    let mut recordings = place.synthetic(&folder)?;
    let data = data.map(Path::to_path_buf).or_else(|| std::env::var_os("ITM_TEST_DATA").map(PathBuf::from));
    match &data {
        Some(data) => recordings.extend(place.real(data)?),
        None => eprintln!("no real recordings: neither --data nor ITM_TEST_DATA names a folder"),
    }

    if recordings.is_empty() {
        bail!("there is no recording {}", only.join(", "));
    }
    let tables = place.tables(&recordings)?;
    println!("{tables}");
    if quick || !only.is_empty() {
        return Ok(());
    }
    let page = workspace_root().join("docs/ACCURACY.md");
    let text = std::fs::read_to_string(&page).with_context(|| format!("can't read {}", page.display()))?;
    let text = with_generated(&text, &tables).with_context(|| format!("in {}", page.display()))?;
    std::fs::write(&page, text).with_context(|| format!("can't write {}", page.display()))?;
    eprintln!("written: {}", page.display());
    Ok(())
}

/// The program that was just built.
fn program() -> Result<PathBuf> {
    let output = cargo().args(["metadata", "--format-version", "1", "--no-deps"]).output()?;
    let metadata: Value = serde_json::from_slice(&output.stdout).context("cargo's metadata can't be read")?;
    let target = metadata["target_directory"].as_str().context("cargo names no target folder")?;
    let itm = Path::new(target).join("release").join(format!("itm{}", std::env::consts::EXE_SUFFIX));
    if !itm.is_file() {
        bail!("{} was not built", itm.display());
    }
    Ok(itm)
}

impl Workplace<'_> {
    fn is_asked_for(&self, name: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|only| only == name)
    }

    fn itm(&self) -> Command {
        let mut itm = Command::new(&self.itm);
        if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
            itm.env("NODEVICE_SELECT", "1");
        }
        itm
    }

    fn synthetic(&mut self, folder: &Path) -> Result<Vec<Recording>> {
        let mut recordings = Vec::new();
        for (name, arguments) in SYNTHETIC {
            if !self.is_asked_for(name) {
                continue;
            }
            let out = folder.join(file_name(name));
            // Written last, so that a recording that was cut off is made again.
            let made = out.join("made_by.txt");
            let line = format!("{} --size 320x240\n", arguments.join(" "));
            if std::fs::read_to_string(&made).ok().as_ref() != Some(&line) {
                eprintln!("making the recording '{name}'");
                if out.exists() {
                    std::fs::remove_dir_all(&out).with_context(|| format!("can't remove {}", out.display()))?;
                }
                steps::run(self.itm().arg("synth").arg(&out).args(arguments).args(["--size", "320x240", "--quiet"]))?;
                std::fs::write(&made, line).with_context(|| format!("can't write {}", made.display()))?;
            }
            match self.probe(name.into(), out)? {
                Ok(recording) => recordings.push(recording),
                Err(reason) => bail!("the recording '{name}' can't be run: {reason}"),
            }
        }
        Ok(recordings)
    }

    /// The folders in `data` that hold a recording.
    fn real(&mut self, data: &Path) -> Result<Vec<Recording>> {
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(data).with_context(|| format!("can't list {}", data.display()))? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            }
        }
        folders.sort();
        let mut recordings = Vec::new();
        for folder in folders {
            let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !self.is_asked_for(&name) {
                continue;
            }
            match self.probe(name, folder.clone())? {
                Ok(recording) => recordings.push(recording),
                Err(reason) => eprintln!("left out: {} ({reason})", folder.display()),
            }
        }
        Ok(recordings)
    }

    /// What is known of a recording once one frame of it was run.
    fn probe(&mut self, name: String, folder: PathBuf) -> Result<Result<Recording, String>> {
        let out = format!("{}-probe", file_name(&name));
        let summary = match self.itm_run(&folder, &out, &["--frames", "0..1"])? {
            Ok(summary) => summary,
            Err(reason) => return Ok(Err(reason)),
        };
        self.device = summary["device"].as_str().unwrap_or("an adapter without a name").to_string();
        let defaults = self.runs.join(out).join("settings.toml");
        Ok(Ok(Recording {
            name,
            folder,
            frames: summary["recording_frames"].as_u64().context("a summary has no recording_frames")?,
            gyroscope: summary["has_gyroscope"].as_bool().unwrap_or(false),
            defaults: std::fs::read_to_string(&defaults)
                .with_context(|| format!("can't read {}", defaults.display()))?,
        }))
    }

    /// One run's summary; why there is none, where the program failed.
    fn itm_run(&self, recording: &Path, out: &str, arguments: &[&str]) -> Result<Result<Value, String>> {
        let mut command = self.itm();
        command.arg("run").arg(recording).arg("-o").arg(self.runs.join(out));
        command.args(["--no-mesh", "--quiet", "--json"]).args(arguments);
        let output =
            command.stdin(Stdio::null()).output().with_context(|| format!("can't run {}", steps::line(&command)))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            let reason = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it failed");
            return Ok(Err(reason.trim_start_matches("error: ").to_string()));
        }
        Ok(Ok(serde_json::from_slice(&output.stdout).context("the summary of a run can't be read")?))
    }

    /// Runs with settings, and again where it is asked whether that gives the same; the cells of a row from ATE on.
    fn measure(&mut self, recording: &Recording, settings: &[(&str, &str)], repeat: bool) -> Result<Vec<String>> {
        let differences: Vec<Difference> = settings
            .iter()
            .filter(|(key, value)| value_of(&recording.defaults, key) != Some(value))
            .map(|(key, value)| Difference { key: (*key).into(), value: (*value).into() })
            .collect();
        let known = (recording.name.clone(), differences.clone());
        if let Some(cells) = self.measured.get(&known) {
            return Ok(cells.clone());
        }
        let mut arguments = vec!["--frames".to_string()];
        let frames = if self.quick { recording.frames.min(QUICK_FRAMES) } else { recording.frames };
        arguments.push(format!("0..{frames}"));
        let mut what = String::new();
        for Difference { key, value } in &differences {
            arguments.extend(["--set".into(), format!("{key}={value}")]);
            write!(what, " {key}={value}")?;
        }
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        eprint!("{},{}: ", recording.name, if what.is_empty() { " defaults" } else { &what });
        let name = file_name(&format!("{}{what}", recording.name));
        let outs = [name.clone(), format!("{name}-again")];
        let trajectory = |out: &String| std::fs::read(self.runs.join(out).join("trajectory.txt"));
        let cells = match self.itm_run(&recording.folder, &outs[0], &arguments)? {
            Ok(first) => {
                let mut cells = figures(&first);
                if repeat {
                    let again = self.itm_run(&recording.folder, &outs[1], &arguments)?;
                    let same = again.is_ok() && trajectory(&outs[0])? == trajectory(&outs[1])?;
                    cells.push(if same { "yes" } else { "**no**" }.into());
                }
                cells
            }
            Err(reason) => {
                let mut cells = vec![format!("not run: {}", reason.replace('|', "/"))];
                cells.resize(FIGURES + usize::from(repeat), "–".into());
                cells
            }
        };
        eprintln!("ATE {} mm, {} lost, {} poor", cells[0], cells[4], cells[5]);
        self.measured.insert(known, cells.clone());
        Ok(cells)
    }

    fn tables(&mut self, recordings: &[Recording]) -> Result<String> {
        let figures = "ATE (mm) | RPE median (mm) | RPE median (°) | RPE rmse (mm) | lost | poor | posed | median (ms)";
        let rule = "| ---: ".repeat(FIGURES);
        let mut text =
            format!("### Trackers\n\n| recording | tracker | {figures} | same |\n| --- | --- {rule}| --- |\n");
        for recording in recordings.iter().filter(|recording| recording.name != EXPOSURE) {
            for (kind, _) in TRACKERS.iter().filter(|(_, inertial)| recording.gyroscope || !inertial) {
                let cells = self.measure(recording, &[("tracker.kind", kind)], true)?.join(" | ");
                writeln!(text, "| {} | {kind} | {cells} |", recording.name)?;
            }
        }
        let head = format!("| recording | setting | with | {figures} |\n| --- | --- | --- {rule}|\n");
        write!(text, "\n### Extensions of the default tracker\n\n{head}")?;
        for recording in recordings {
            for (setting, needs) in EXTENSIONS {
                if recording.name == EXPOSURE && !setting.ends_with("estimate_exposure") {
                    continue;
                }
                for value in ["true", "false"] {
                    let settings: Vec<_> = needs.iter().map(|need| (*need, "true")).chain([(setting, value)]).collect();
                    let cells = self.measure(recording, &settings, false)?[..FIGURES].join(" | ");
                    writeln!(text, "| {} | {setting} = {value} | {} | {cells} |", recording.name, needs.join(", "))?;
                }
            }
        }
        let frames = if self.quick { format!(", the first {QUICK_FRAMES} frames") } else { String::new() };
        Ok(format!("Measured on {}{frames}, with itm {}.\n\n{text}", self.device, env!("CARGO_PKG_VERSION")))
    }
}

/// Columns of figures.
const FIGURES: usize = 8;

/// The figures of a run's summary.
fn figures(summary: &Value) -> Vec<String> {
    let number = |value: &Value, factor: f64, decimals: usize| match value.as_f64() {
        Some(value) => format!("{:.decimals$}", value * factor),
        None => "–".into(),
    };
    let of_truth = &summary["evaluation"];
    let count = |key: &str| summary[key].as_u64().map_or_else(|| "–".into(), |count| count.to_string());
    let degrees = 180.0 / std::f64::consts::PI;
    vec![
        number(&of_truth["ate"]["rmse"], 1e3, 2),
        number(&of_truth["rpe_translation"]["median"], 1e3, 2),
        number(&of_truth["rpe_rotation"]["median"], degrees, 3),
        number(&of_truth["rpe_translation"]["rmse"], 1e3, 2),
        count("lost"),
        count("poor"),
        format!("{} %", number(&summary["posed_share"], 100.0, 1)),
        number(&summary["median_frame_ms"], 1.0, 1),
    ]
}

/// A setting's value in a tree as `itm run` writes it, one key a line below its group; text without its quotes.
fn value_of<'a>(toml: &'a str, key: &str) -> Option<&'a str> {
    let (group, name) = key.rsplit_once('.')?;
    let mut within = false;
    for line in toml.lines() {
        if let Some(header) = line.strip_prefix('[') {
            within = header.strip_suffix(']') == Some(group);
        } else if within
            && let Some((own, value)) = line.split_once(" = ")
            && own == name
        {
            return Some(value.trim_matches('"'));
        }
    }
    None
}

/// A name as part of a file's.
fn file_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._=".contains(c) { c } else { '-' };
    name.chars().map(plain).collect()
}

/// The page with another generated part.
fn with_generated(page: &str, generated: &str) -> Result<String> {
    let (before, rest) = page.split_once(BEGIN).with_context(|| format!("there is no line {BEGIN}"))?;
    let (_, after) = rest.split_once(END).with_context(|| format!("there is no line {END} after {BEGIN}"))?;
    Ok(format!("{before}{BEGIN}\n\n{}\n\n{END}{after}", generated.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generated_part_alone_is_replaced() {
        let page = format!("# Title\n{BEGIN}\nold\n{END}\nend\n");
        let new = with_generated(&page, "| new |\n").unwrap();
        assert_eq!(new, format!("# Title\n{BEGIN}\n\n| new |\n\n{END}\nend\n"));
        assert_eq!(with_generated(&new, "| new |").unwrap(), new);
        assert!(with_generated(END, "x").is_err() && with_generated(BEGIN, "x").is_err());
        let own = std::fs::read_to_string(workspace_root().join("docs/ACCURACY.md")).unwrap();
        assert!(with_generated(&own, "x").is_ok());
    }

    #[test]
    fn figures_that_there_are_none_of_are_dashes() {
        let summary = serde_json::json!({
            "evaluation": {
                "ate": { "rmse": 0.0123 },
                "rpe_translation": { "rmse": 0.004, "median": 0.003 },
                "rpe_rotation": { "median": std::f64::consts::PI / 180.0 },
            },
            "lost": 2, "poor": 1, "posed_share": 0.9, "median_frame_ms": 12.34,
        });
        let expected = ["12.30", "3.00", "1.000", "4.00", "2", "1", "90.0 %", "12.3"];
        assert_eq!(figures(&summary), expected);
        assert_eq!(expected.len(), FIGURES);
        let nothing = figures(&serde_json::json!({ "evaluation": null, "lost": 0, "poor": 0, "posed_share": 0 }));
        assert_eq!(nothing, ["–", "–", "–", "–", "0", "0", "0.0 %", "–"]);
    }

    #[test]
    fn defaults_are_found_in_their_group() {
        let toml = "[view]\ncolour = true\n\n[tracker]\nkind = \"icp\"\n\n[tracker.extended]\ncolour = false\n";
        assert_eq!(value_of(toml, "tracker.kind"), Some("icp"));
        assert_eq!(value_of(toml, "tracker.extended.colour"), Some("false"));
        assert_eq!(value_of(toml, "view.colour"), Some("true"));
        assert_eq!(value_of(toml, "map.colour"), None);
    }
}
