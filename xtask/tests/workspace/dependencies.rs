//! Dependencies point downwards only, and few crates may know the GPU or a window.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

use crate::{assert_none, root};

/// Every crate of the workspace with its layer. A crate may depend on crates of lower layers only.
const LAYERS: &[(&str, u32)] = &[
    ("itm-core", 0),
    ("itm-assets", 0),
    ("itm-shaders", 0),
    ("itm-io", 1),
    ("itm-gpu", 1),
    ("itm-reloc", 1),
    ("itm-graph", 1),
    ("itm-synth", 1),
    ("itm-slam", 2),
    ("itm-viewer", 3),
    ("itm-cli", 4),
    ("itm-py", 5),
    ("itm-tests", 6),
    // Depends on none of them, so that it builds at once, which the lowest layer enforces.
    ("xtask", 0),
];

/// Crates that must build on a machine without anything for graphics.
const WITHOUT_GPU: &[&str] = &["itm-core", "itm-reloc", "itm-graph"];

/// The only crate that may know egui.
const WINDOWED: &str = "itm-viewer";

/// What a member of the workspace depends on, by package name.
#[derive(Default)]
struct Member {
    /// Dependencies of the library or program and of its build script.
    built: BTreeSet<String>,
    /// Dependencies of tests and examples.
    dev: BTreeSet<String>,
}

type Members = BTreeMap<String, Member>;

/// The manifests as cargo reads them. `--no-deps` needs no network, nor any other package's manifest.
fn members() -> Members {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let arguments = ["metadata", "--format-version", "1", "--no-deps", "--offline"];
    let output = Command::new(cargo).args(arguments).current_dir(root()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut members = Members::new();
    for package in metadata["packages"].as_array().unwrap() {
        let member = members.entry(package["name"].as_str().unwrap().to_owned()).or_default();
        for dependency in package["dependencies"].as_array().unwrap() {
            let kind = if dependency["kind"] == "dev" { &mut member.dev } else { &mut member.built };
            kind.insert(dependency["name"].as_str().unwrap().to_owned());
        }
    }
    members
}

/// The packages of `Cargo.lock`, each with the names of those it depends on. Versions are left out: a name stands for
/// all of them, which can only find too much.
fn locked() -> BTreeMap<String, BTreeSet<String>> {
    let text = std::fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let lock: toml::Table = text.parse().unwrap();
    let mut packages = BTreeMap::<_, BTreeSet<_>>::new();
    for package in lock["package"].as_array().unwrap() {
        let names = packages.entry(package["name"].as_str().unwrap().to_owned()).or_default();
        for dependency in package.get("dependencies").and_then(toml::Value::as_array).into_iter().flatten() {
            let name = dependency.as_str().unwrap().split(' ').next().unwrap();
            names.insert(name.to_owned());
        }
    }
    packages
}

fn layer(name: &str) -> Option<u32> {
    LAYERS.iter().find(|(known, _)| *known == name).map(|&(_, layer)| layer)
}

fn upward_dependencies(members: &Members) -> Vec<String> {
    let mut violations = Vec::new();
    for (name, member) in members {
        let Some(own) = layer(name) else {
            violations.push(format!("{name} has no layer: give it one in {}", file!()));
            continue;
        };
        for dependency in &member.built {
            if let Some(other) = layer(dependency).filter(|&other| other >= own) {
                violations.push(format!("{name} (layer {own}) depends on {dependency} (layer {other})"));
            }
        }
    }
    violations
}

/// Cycles through dependencies of any kind: cargo allows those through a dev-dependency, where the crate under test and
/// the one that its tests see are two different ones.
fn cycles(members: &Members) -> Vec<String> {
    let edges = |name: &str| members.get(name).into_iter().flat_map(|member| member.built.iter().chain(&member.dev));
    let mut violations = Vec::new();
    for name in members.keys() {
        let mut reached = BTreeSet::new();
        let mut open: Vec<&str> = edges(name).map(String::as_str).collect();
        while let Some(next) = open.pop() {
            if reached.insert(next) {
                open.extend(edges(next).map(String::as_str));
            }
        }
        if reached.contains(name.as_str()) {
            violations.push(format!("{name} depends on itself"));
        }
    }
    violations
}

/// Every package that `name` is built with: a member's manifest tells apart what only its tests need, the lock file
/// knows the rest.
fn built_with(name: &str, members: &Members, locked: &BTreeMap<String, BTreeSet<String>>) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut open = vec![name.to_owned()];
    while let Some(next) = open.pop() {
        let dependencies = members.get(&next).map(|member| &member.built).or_else(|| locked.get(&next));
        for dependency in dependencies.into_iter().flatten() {
            if reached.insert(dependency.clone()) {
                open.push(dependency.clone());
            }
        }
    }
    reached
}

fn is_egui(name: &str) -> bool {
    name == "eframe" || name == "egui" || name.starts_with("egui-") || name.starts_with("egui_")
}

fn windows_elsewhere(members: &Members) -> Vec<String> {
    let mut violations = Vec::new();
    for (name, member) in members.iter().filter(|(name, _)| *name != WINDOWED) {
        for dependency in member.built.iter().chain(&member.dev).filter(|dependency| is_egui(dependency)) {
            violations.push(format!("{name} depends on {dependency}"));
        }
    }
    violations
}

#[test]
fn dependencies_point_downwards() {
    assert_none("A crate depends on lower layers only", &upward_dependencies(&members()));
}

#[test]
fn dependencies_have_no_cycles() {
    assert_none("No crate reaches itself, not even through its tests", &cycles(&members()));
}

#[test]
fn the_vocabulary_builds_without_a_gpu() {
    let (members, locked) = (members(), locked());
    assert!(members.contains_key("itm-core"));
    assert!(
        built_with("itm-gpu", &members, &locked).contains("wgpu-hal"),
        "itm-gpu should reach wgpu-hal through wgpu"
    );
    for name in WITHOUT_GPU.iter().filter(|name| members.contains_key(**name)) {
        let built_with = built_with(name, &members, &locked);
        let graphics: Vec<_> = built_with
            .into_iter()
            .filter(|name| name == "naga" || name == "wgpu" || name.starts_with("wgpu-"))
            .collect();
        assert_none(&format!("{name} builds without wgpu"), &graphics);
    }
}

#[test]
fn slam_meets_wgpu_through_itm_gpu_only() {
    let members = members();
    let slam = &members["itm-slam"];
    let direct: Vec<_> =
        slam.built.union(&slam.dev).filter(|name| name.starts_with("wgpu") || *name == "naga").cloned().collect();
    assert_none("itm-slam holds no wgpu call", &direct);
}

#[test]
fn only_the_viewer_knows_egui() {
    assert_none("Only itm-viewer may depend on egui", &windows_elsewhere(&members()));
}

#[cfg(test)]
mod rules {
    use super::*;

    fn member(built: &[&str], dev: &[&str]) -> Member {
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        Member { built: names(built), dev: names(dev) }
    }

    fn workspace<const N: usize>(members: [(&str, Member); N]) -> Members {
        members.into_iter().map(|(name, member)| (name.to_owned(), member)).collect()
    }

    #[test]
    fn upward_and_sideways_dependencies_are_found() {
        let upward = workspace([("itm-core", member(&["itm-io"], &[]))]);
        assert_eq!(upward_dependencies(&upward), ["itm-core (layer 0) depends on itm-io (layer 1)"]);
        let sideways = workspace([("itm-io", member(&["itm-core", "itm-gpu"], &[]))]);
        assert_eq!(upward_dependencies(&sideways), ["itm-io (layer 1) depends on itm-gpu (layer 1)"]);
        let ours = workspace([("xtask", member(&["itm-core"], &[]))]);
        assert_eq!(upward_dependencies(&ours).len(), 1);
    }

    #[test]
    fn tests_may_depend_upwards_but_not_in_a_circle() {
        let upward = workspace([("itm-io", member(&[], &["itm-synth"])), ("itm-synth", member(&["itm-core"], &[]))]);
        assert!(upward_dependencies(&upward).is_empty() && cycles(&upward).is_empty());
        let circle = workspace([("itm-io", member(&[], &["itm-slam"])), ("itm-slam", member(&["itm-io"], &[]))]);
        assert_eq!(cycles(&circle).len(), 2);
    }

    #[test]
    fn a_crate_without_a_layer_is_found() {
        assert_eq!(upward_dependencies(&workspace([("itm-new", member(&[], &[]))])).len(), 1);
    }

    #[test]
    fn what_a_crate_is_built_with_leaves_out_what_its_tests_need() {
        let members =
            workspace([("itm-io", member(&["itm-core"], &["gltf"])), ("itm-core", member(&["glam"], &["wgpu"]))]);
        let locked = [("glam", vec!["libm"]), ("itm-core", vec!["glam", "wgpu"])];
        let locked = locked.map(|(name, all)| (name.to_owned(), all.into_iter().map(str::to_owned).collect()));
        let expected = ["glam", "itm-core", "libm"].map(str::to_owned);
        assert_eq!(built_with("itm-io", &members, &locked.into()), expected.into());
    }

    #[test]
    fn egui_elsewhere_is_found() {
        let members = workspace([("itm-viewer", member(&["egui"], &[])), ("itm-cli", member(&[], &["egui_kittest"]))]);
        assert_eq!(windows_elsewhere(&members), ["itm-cli depends on egui_kittest"]);
    }
}
