//! Sees to it that the machine has a Vulkan adapter, and cargo the components that the checks need.

use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::distribution::Distribution;
use crate::steps::line;
use crate::vulkan::Vulkan;

/// Whether packages may be installed; that takes root or a sudo that asks for no password as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Installing {
    Allowed,
    Forbidden,
}

/// Makes sure, as far as can be told from files, that there is a Vulkan adapter. Where there is none it installs the
/// software driver, or fails with what to type.
pub(crate) fn adapter(installing: Installing) -> Result<()> {
    if !cfg!(target_os = "linux") {
        println!("Graphics: nothing to set up, {} comes with a driver", std::env::consts::OS);
        return Ok(());
    }
    compiler(installing)?;
    let found = Vulkan::of_this_machine();
    if found.is_ready() {
        describe(&found)
    } else {
        install_software_driver(&found, installing)?
    };
    Ok(())
}

/// Makes sure that the viewer can be tested: it is run in a virtual display.
pub(crate) fn display(installing: Installing) -> Result<()> {
    // Called without arguments it would begin to serve.
    if !cfg!(target_os = "linux") || succeeds(Command::new("Xvfb").arg("-help")) {
        return Ok(());
    }
    let advice = "there is no virtual display (Xvfb), in which the viewer is tested. Install one: on Debian and Ubuntu, \
                  apt-get install xvfb; on Fedora, dnf install xorg-x11-server-Xvfb; on Arch, pacman -S xorg-server-xvfb";
    // What windows are opened with is loaded by name, so that a viewer starts on machines without it and says so.
    let packages = [
        "xvfb",
        "libx11-6",
        "libx11-xcb1",
        "libxcursor1",
        "libxi6",
        "libxrandr2",
        "libxkbcommon0",
        "libxkbcommon-x11-0",
    ];
    install_on_debian(installing, "Display: none for tests of the viewer", &packages, advice)
}

/// Makes sure that there is a C++ compiler, which two of the libraries are built with.
fn compiler(installing: Installing) -> Result<()> {
    if std::env::var_os("CXX").is_some() || succeeds(Command::new("c++").arg("--version")) {
        return Ok(());
    }
    let advice = "there is no C++ compiler (c++), which zstd and meshoptimizer are built with. Install one: on Debian and \
                  Ubuntu, apt-get install build-essential";
    install_on_debian(installing, "Compiler: there is none for C++", &["g++"], advice)
}

/// Installs packages on Debian and its derivatives, where that is allowed; fails with the advice where it is not.
pub(crate) fn install_on_debian(installing: Installing, lack: &str, packages: &[&str], advice: &str) -> Result<()> {
    let debian = Distribution::of_this_machine() == Distribution::Debian;
    let Some(become_root) = root_prefix(installing).filter(|_| debian) else { bail!("{advice}") };
    println!("{lack}. Installing {} with apt-get", packages.join(" "));
    apt_get_install(become_root, packages, advice)
}

/// Installs packages as root.
fn apt_get_install(mut become_root: Vec<&str>, packages: &[&str], advice: &str) -> Result<()> {
    become_root.extend(["env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]);
    let apt_get = |arguments: &[&str]| {
        run_quietly(Command::new(become_root[0]).args(&become_root[1..]).args(arguments)).context(advice.to_string())
    };
    let install = [&["install", "--yes", "--no-install-recommends"], packages].concat();
    // Lists that are missing, as in a fresh container, or older than what the mirrors still hold both fail here.
    if apt_get(&install).is_err() {
        apt_get(&["update"])?;
        apt_get(&install)?;
    }
    Ok(())
}

/// Installs the software driver beside a hardware driver that offers no adapter. Returns whether there was something to
/// install.
pub(crate) fn fall_back_to_software(installing: Installing) -> Result<bool> {
    let found = Vulkan::of_this_machine();
    if !cfg!(target_os = "linux") || found.software_driver().is_some() {
        return Ok(false);
    }
    install_software_driver(&found, installing)?;
    Ok(true)
}

/// Makes sure that cargo has rustfmt and clippy.
pub(crate) fn components(installing: Installing) -> Result<()> {
    let components = [("fmt", "rustfmt"), ("clippy", "clippy")];
    let missing: Vec<_> = components
        .iter()
        .filter(|(command, _)| !succeeds(cargo().args([command, "--version"])))
        .map(|&(_, name)| name)
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    let names = missing.join(" ");
    if installing == Installing::Forbidden || !succeeds(Command::new("rustup").arg("--version")) {
        bail!("cargo lacks {names}. With rustup (https://rustup.rs), type\n\n    rustup component add {names}\n");
    }
    println!("Cargo lacks {names}: installing");
    run_quietly(Command::new("rustup").args(["component", "add"]).args(missing))
}

/// The cargo that runs this program, in the workspace's folder.
pub(crate) fn cargo() -> Command {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(crate::workspace_root());
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // Without a desktop, Mesa's device-select layer prints an error for each program that lists adapters.
        cargo.env("NODEVICE_SELECT", "1");
    }
    cargo
}

/// Whether `command` can be started and succeeds; what it prints is dropped.
pub(crate) fn succeeds(command: &mut Command) -> bool {
    command.output().is_ok_and(|output| output.status.success())
}

fn describe(found: &Vulkan) {
    if let Some(manifest) = found.hardware_driver() {
        println!("Graphics: a GPU and its Vulkan driver ({})", manifest.display());
    } else if let Some(manifest) = found.software_driver() {
        println!("Graphics: no GPU, the software Vulkan driver ({})", manifest.display());
    }
}

/// Installs the loader and the software driver on Debian and its derivatives, and looks whether that helped.
fn install_software_driver(found: &Vulkan, installing: Installing) -> Result<()> {
    let lack = lack(found);
    if let Some(variable) = found.overridden_by.filter(|_| found.manifests.is_empty()) {
        bail!("{lack}: the environment variable {variable} names no driver's manifest. Unset or correct it");
    }
    let distribution = Distribution::of_this_machine();
    let Some(become_root) = root_prefix(installing).filter(|_| distribution == Distribution::Debian) else {
        bail!(advice(lack, distribution));
    };
    let packages = distribution.packages();
    println!("Graphics: {lack}. Installing {} with apt-get", packages.join(" "));
    apt_get_install(become_root, packages, &advice(lack, distribution))?;
    let found = Vulkan::of_this_machine();
    if !found.is_ready() {
        bail!("{} are installed, and yet {}", packages.join(" and "), self::lack(&found));
    }
    describe(&found);
    Ok(())
}

/// What is missing, as the middle of a sentence.
fn lack(found: &Vulkan) -> &'static str {
    match (found.loader, found.manifests.is_empty()) {
        (false, _) => "the Vulkan loader (libvulkan.so.1) is missing",
        (true, true) => "no Vulkan driver is installed",
        (true, false) => "the installed Vulkan drivers are for GPUs, and offer no adapter here",
    }
}

/// What a user can do about it.
fn advice(lack: &str, distribution: Distribution) -> String {
    let commands = distribution.commands();
    if commands.is_empty() {
        return format!(
            "{lack}. Install the Vulkan loader and a driver: your GPU's, or Mesa's software driver lavapipe, which most \
             distributions have in a package named like mesa-vulkan-drivers or vulkan-swrast"
        );
    }
    format!("{lack}. Type\n\n    {}\n\nand run this again", commands.join("\n    "))
}

/// What to put before a command so that it runs as root; nothing where that would need a password.
fn root_prefix(installing: Installing) -> Option<Vec<&'static str>> {
    let is_root = || Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0");
    match installing {
        Installing::Forbidden => None,
        Installing::Allowed if is_root() => Some(Vec::new()),
        Installing::Allowed => succeeds(Command::new("sudo").args(["-n", "true"])).then(|| vec!["sudo", "-n"]),
    }
}

/// Runs a command whose output is of interest only where it fails.
fn run_quietly(command: &mut Command) -> Result<()> {
    let output = command.output().with_context(|| format!("can't run {}", line(command)))?;
    if output.status.success() {
        return Ok(());
    }
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    bail!("{} failed, {}:\n{stdout}{stderr}", line(command), output.status);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_says_what_to_type() {
        let advice = advice("no Vulkan driver is installed", Distribution::Debian);
        assert!(advice.starts_with("no Vulkan driver is installed. Type\n"), "{advice}");
        assert!(
            advice.contains("\n    sudo apt-get install --no-install-recommends mesa-vulkan-drivers libvulkan1\n"),
            "{advice}"
        );
    }

    #[test]
    fn advice_for_an_unknown_distribution_names_the_driver() {
        assert!(advice("no Vulkan driver is installed", Distribution::Unknown).contains("lavapipe"));
    }

    #[test]
    fn what_is_missing_follows_from_what_was_found() {
        let nothing = Vulkan { loader: false, manifests: vec![], gpu: false, overridden_by: None };
        assert!(lack(&nothing).contains("loader"));
        let loader = Vulkan { loader: true, ..nothing };
        assert!(lack(&loader).contains("no Vulkan driver"));
        let hardware_only = Vulkan { manifests: vec!["nvidia_icd.json".into()], ..loader };
        assert!(lack(&hardware_only).contains("for GPUs"));
    }

    #[test]
    fn nothing_becomes_root_where_installing_is_forbidden() {
        assert_eq!(root_prefix(Installing::Forbidden), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_quiet_command_that_fails_shows_what_it_printed() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo to stdout; echo to stderr >&2; exit 3"]);
        let error = run_quietly(&mut command).unwrap_err().to_string();
        assert!(error.contains("to stdout\nto stderr") && error.contains('3'), "{error}");
        assert!(run_quietly(&mut Command::new("true")).is_ok());
    }
}
