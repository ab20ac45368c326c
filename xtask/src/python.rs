//! Builds the Python package and runs its tests, in a virtual environment of their own below the target folder.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::setup::{self, Installing, succeeds};
use crate::steps::{Step, run};
use crate::workspace_root;

/// The package, from the workspace's root.
const PACKAGE: &str = "crates/itm-py";

/// The versions of what its tests take, from there.
const REQUIREMENTS: &str = "tests/requirements.txt";

/// Names the program `itm` to the tests, which compare its results with the package's.
const PROGRAM: &str = "ITM_PROGRAM";

/// What an interpreter must have.
const FITS: &str = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 9))";

/// This program's own task, as one of several steps.
pub(crate) fn step(installing: Installing) -> Result<Step> {
    let mut command = Command::new(std::env::current_exe().context("can't find this program")?);
    command.arg("python");
    // The steps before have built it, of these very sources.
    command.env(PROGRAM, target_folder().join("debug").join(format!("itm{}", std::env::consts::EXE_SUFFIX)));
    if installing == Installing::Forbidden {
        command.arg("--no-install");
    }
    Ok(Step::new("python", command))
}

/// Sets up what is missing, builds the package and runs its tests, which check the types as well.
pub(crate) fn test(installing: Installing) -> Result<()> {
    if std::env::var_os("ITM_SKIP_PYTHON_TESTS").is_some() {
        println!("Python: not tested, as ITM_SKIP_PYTHON_TESTS is set");
        return Ok(());
    }
    setup::adapter(installing)?;
    let environment = environment(installing)?;
    let package = workspace_root().join(PACKAGE);
    let mut develop = environment.command("maturin");
    develop.args(["develop", "--quiet", "--manifest-path"]).arg(package.join("Cargo.toml"));
    run(&mut develop)?;
    let mut pytest = environment.command("python");
    pytest.args(["-m", "pytest", "--quiet"]).current_dir(&package).env("NODEVICE_SELECT", "1");
    run(&mut pytest)?;
    Ok(())
}

/// A virtual environment.
struct Environment {
    folder: PathBuf,
}

impl Environment {
    fn command(&self, name: &str) -> Command {
        let programs = self.folder.join(if cfg!(windows) { "Scripts" } else { "bin" });
        let mut command = Command::new(programs.join(name));
        command.env("VIRTUAL_ENV", &self.folder).env_remove("CONDA_PREFIX").env_remove("PYTHONHOME");
        command
    }
}

/// The environment with the packages that the tests take; made anew where these, or the interpreter, are others than before.
fn environment(installing: Installing) -> Result<Environment> {
    let python = interpreter(installing)?;
    let version = Command::new(&python).arg("-VV").output().context("can't ask for Python's version")?;
    let requirements = workspace_root().join(PACKAGE).join(REQUIREMENTS);
    let wanted =
        std::fs::read_to_string(&requirements).with_context(|| format!("can't read '{}'", requirements.display()))?;
    let wanted = format!("{}\n{wanted}", String::from_utf8_lossy(&version.stdout));
    let environment = Environment { folder: target_folder().join("python") };
    let marker = environment.folder.join("installed.txt");
    if std::fs::read_to_string(&marker).is_ok_and(|installed| installed == wanted) {
        return Ok(environment);
    }
    println!("Python: installing what its tests take in '{}'", environment.folder.display());
    run(Command::new(&python).args(["-m", "venv", "--clear"]).arg(&environment.folder))?;
    let mut install = environment.command("python");
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"]).arg(&requirements);
    run(&mut install).with_context(|| {
        "pip can't install what the tests of the Python package take (maturin, mcap, mypy, numpy, pytest, trimesh). They need PyPI, or \
         a mirror that pip knows; where there is none, set ITM_SKIP_PYTHON_TESTS=1 to leave these tests out"
            .to_string()
    })?;
    std::fs::write(&marker, wanted).with_context(|| format!("can't write '{}'", marker.display()))?;
    Ok(environment)
}

/// A Python that will do; installed on Debian and its derivatives where there is none and that is allowed.
fn interpreter(installing: Installing) -> Result<PathBuf> {
    let fits = |name: &&str| succeeds(Command::new(name).args(["-c", FITS]));
    let find = || ["python3", "python"].iter().find(|name| fits(name)).map(PathBuf::from);
    if let Some(found) = find() {
        return Ok(found);
    }
    let advice = "there is no Python 3.9 or later with venv, which the Python package is tested with. Install one (on Debian and \
                  Ubuntu, apt-get install python3 python3-venv), or set ITM_SKIP_PYTHON_TESTS=1 to leave these tests out";
    setup::install_on_debian(installing, "Python: none is installed", &["python3", "python3-venv"], advice)?;
    match find() {
        Some(found) => Ok(found),
        None => bail!("{advice}"),
    }
}

/// Where cargo builds.
fn target_folder() -> PathBuf {
    let chosen = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    chosen.map_or_else(|| workspace_root().join("target"), |folder| workspace_root().join(folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_requirement_has_one_version() {
        let text = std::fs::read_to_string(workspace_root().join(PACKAGE).join(REQUIREMENTS)).unwrap();
        let requirements = text.lines().filter(|line| !line.starts_with('#'));
        for line in requirements {
            let requirement = line.split(';').next().unwrap();
            assert!(requirement.contains("=="), "{line}");
        }
    }

    #[test]
    fn the_package_lies_where_it_is_looked_for() {
        assert!(workspace_root().join(PACKAGE).join("pyproject.toml").is_file());
    }
}
