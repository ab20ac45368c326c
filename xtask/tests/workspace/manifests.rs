//! The manifests of the workspace's crates: lints inherited, versions in one place.

use std::path::PathBuf;

use toml::{Table, Value};

use crate::{assert_none, root};

/// Keys of `[package]` that the workspace decides.
const INHERITED: &[&str] = &["version", "edition", "rust-version", "license", "repository", "authors"];

/// The manifests of all members, as paths below the root with their contents.
fn manifests() -> Vec<(PathBuf, Table)> {
    let mut found = Vec::new();
    for path in crate::tidy::files().into_iter().filter(|path| path.ends_with("Cargo.toml")) {
        let text = std::fs::read_to_string(root().join(&path)).unwrap();
        let manifest: Table = text.parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        if manifest.contains_key("package") {
            found.push((path, manifest));
        }
    }
    assert!(found.len() > 5, "found only {} manifests below {}", found.len(), root().display());
    found
}

fn is_inherited(value: Option<&Value>) -> bool {
    value.and_then(|value| value.get("workspace")).and_then(Value::as_bool) == Some(true)
}

/// What a member's manifest decides for itself, and should inherit.
fn not_inherited(manifest: &Table) -> Vec<String> {
    let mut violations = Vec::new();
    if !is_inherited(manifest.get("lints").map(|lints| lints as &Value)) {
        violations.push("[lints]".to_owned());
    }
    for key in INHERITED {
        if !is_inherited(manifest["package"].get(key)) {
            violations.push(format!("package.{key}"));
        }
    }
    let platforms = manifest.get("target").and_then(Value::as_table).into_iter().flatten();
    let tables = std::iter::once(manifest).chain(platforms.filter_map(|(_, platform)| platform.as_table()));
    for table in tables {
        for kind in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let dependencies = table.get(kind).and_then(Value::as_table).into_iter().flatten();
            violations.extend(
                dependencies.filter(|(_, it)| !is_inherited(Some(it))).map(|(name, _)| format!("{kind}.{name}")),
            );
        }
    }
    violations
}

#[test]
fn crates_inherit_what_the_workspace_decides() {
    let mut violations = Vec::new();
    for (path, manifest) in manifests() {
        violations.extend(not_inherited(&manifest).iter().map(|key| format!("{}: {key}", path.display())));
    }
    assert_none("Lints and versions stand once, in the root Cargo.toml; members write `workspace = true`", &violations);
}

#[cfg(test)]
mod rules {
    use super::*;

    const GOOD: &str = r#"
        lints.workspace = true
        [package]
        name = "itm-good"
        version.workspace = true
        edition.workspace = true
        rust-version.workspace = true
        license.workspace = true
        repository.workspace = true
        authors.workspace = true
        [dependencies]
        glam.workspace = true
        wgpu = { workspace = true, features = ["metal"] }
    "#;

    fn check(manifest: &str) -> Vec<String> {
        not_inherited(&manifest.parse().unwrap())
    }

    #[test]
    fn a_manifest_that_inherits_all_is_fine() {
        assert!(check(GOOD).is_empty());
    }

    #[test]
    fn what_is_not_inherited_is_found() {
        assert_eq!(check(&GOOD.replace("lints.workspace = true", "")), ["[lints]"]);
        assert_eq!(check(&GOOD.replace("edition.workspace = true", "edition = '2024'")), ["package.edition"]);
        assert_eq!(check(&GOOD.replace("glam.workspace = true", "glam = '1'")), ["dependencies.glam"]);
        let unix = format!("{GOOD}\n[target.'cfg(unix)'.dev-dependencies]\nlibc = {{ version = '1' }}");
        assert_eq!(check(&unix), ["dev-dependencies.libc"]);
    }
}
