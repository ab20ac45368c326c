//! What files must look like.

use std::path::{Path, PathBuf};

use crate::{assert_none, root};

/// No file may be larger, in bytes: a clone should stay small for ever.
const LARGEST: u64 = 1 << 20;

/// Files that may be larger, each with its reason.
const LARGER: &[&str] = &[];

/// The folder of all shaders.
const SHADERS: &str = "shaders";

/// All files of the workspace that git does not ignore, as sorted paths below its root.
pub(crate) fn files() -> Vec<PathBuf> {
    // Hidden files count (.ci, .cargo), and .gitignore does also where the sources came without git's folder.
    let walk = ignore::WalkBuilder::new(root())
        .hidden(false)
        .require_git(false)
        .parents(false)
        .git_global(false)
        .filter_entry(|entry| entry.file_name() != ".git")
        .build();
    let entries = walk.map(|entry| entry.unwrap()).filter(|entry| entry.file_type().is_some_and(|kind| kind.is_file()));
    let mut files: Vec<_> =
        entries.map(|entry| entry.path().strip_prefix(root()).expect("walked from the root").to_owned()).collect();
    files.sort();
    assert!(files.iter().any(|file| file == Path::new("Cargo.toml")), "no files found below {}", root().display());
    files
}

/// The text of every file that is one, with its path below the root.
fn texts() -> Vec<(PathBuf, String)> {
    let read = |path: PathBuf| {
        let bytes = std::fs::read(root().join(&path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let text = String::from_utf8(bytes).ok().filter(|text| !text.contains('\0'))?;
        Some((path, text))
    };
    files().into_iter().filter_map(read).collect()
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|own| own == extension)
}

/// Applies `rule` to each line of the texts and names the places where it holds.
fn lines_where<'a>(texts: impl IntoIterator<Item = &'a (PathBuf, String)>, rule: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for (path, text) in texts {
        let lines = text.lines().enumerate().filter(|(_, line)| rule(line));
        found.extend(lines.map(|(index, line)| format!("{}:{}: {}", path.display(), index + 1, line.trim())));
    }
    found
}

fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with("//")
}

/// Whether `word` stands in `line` with no letter, digit or underscore at either side.
fn contains_word(line: &str, word: &str) -> bool {
    let joins = |c: char| c.is_alphanumeric() || c == '_';
    line.match_indices(word).any(|(start, _)| {
        let (before, after) = (&line[..start], &line[start + word.len()..]);
        !before.ends_with(joins) && !after.starts_with(joins)
    })
}

/// Whether `line` holds a path below `folder`, which is absolute. What follows a name, as in a web address, is no
/// absolute path.
fn contains_path_below(line: &str, folder: &str) -> bool {
    let continues_name = |c: char| c.is_alphanumeric() || "._~-/{}*<>".contains(c);
    line.match_indices(folder).any(|(start, _)| {
        let (before, after) = (&line[..start], &line[start + folder.len()..]);
        !before.ends_with(continues_name) && after.starts_with(['/', '\\'])
    })
}

fn machine_specific(line: &str, own_folder: &str) -> bool {
    let folders = ["/root", "/home", "/Users", r"C:\Users", own_folder];
    folders.iter().any(|folder| contains_path_below(line, folder))
}

/// Macros and attributes that mark unfinished or switched-off code; in two parts, so that this file has none.
fn unfinished(line: &str) -> bool {
    let marks = [concat!("todo", "!("), concat!("unimplemented", "!("), concat!("#[", "ignore")];
    !is_comment(line) && marks.iter().any(|mark| line.contains(mark))
}

/// WGSL in a line of Rust.
fn shader_text(line: &str) -> bool {
    let marks = ["@compute", "@workgroup_size", "@builtin(", "@group(", "var<storage", "var<workgroup"];
    !is_comment(line) && marks.iter().any(|mark| line.contains(mark))
}

#[test]
fn no_path_is_of_one_machine() {
    let own_folder = root().to_str().expect("a path in UTF-8");
    let texts: Vec<_> = texts().into_iter().filter(|(path, _)| path != Path::new(file!())).collect();
    let found = lines_where(&texts, |line| machine_specific(line, own_folder));
    assert_none("A path that exists on one machine only", &found);
}

#[test]
fn no_code_is_unfinished_or_switched_off() {
    let texts = texts();
    let rust = texts.iter().filter(|(path, _)| has_extension(path, "rs"));
    assert_none("Finish it, or leave it out", &lines_where(rust, unfinished));
}

#[test]
fn shaders_lie_in_their_folder() {
    let elsewhere = files().into_iter().filter(|path| has_extension(path, "wgsl") && !path.starts_with(SHADERS));
    let elsewhere: Vec<_> = elsewhere.map(|path| path.display().to_string()).collect();
    assert_none("WGSL lies in shaders/ only", &elsewhere);
}

#[test]
fn no_shader_is_written_in_rust() {
    let texts = texts();
    // The build script reads shaders, and so names their attributes.
    let exempt = [Path::new("shaders/build.rs"), Path::new(file!())];
    let rust = texts.iter().filter(|(path, _)| has_extension(path, "rs") && !exempt.contains(&path.as_path()));
    assert_none("Shaders are files below shaders/, which the build checks", &lines_where(rust, shader_text));
}

#[test]
fn slam_has_no_gpu_code() {
    let texts = texts();
    let slam: Vec<_> = texts
        .into_iter()
        .filter(|(path, _)| path.starts_with("crates/itm-slam/src") && has_extension(path, "rs"))
        .collect();
    assert!(!slam.is_empty());
    let found = lines_where(&slam, |line| !is_comment(line) && contains_word(line, "wgpu"));
    assert_none("itm-slam meets the GPU through itm-gpu only", &found);
}

#[test]
fn texts_end_with_a_newline() {
    let cut: Vec<_> = texts().into_iter().filter(|(_, text)| !text.is_empty() && !text.ends_with('\n')).collect();
    let cut: Vec<_> = cut.iter().map(|(path, _)| path.display().to_string()).collect();
    assert_none("A text file ends with a newline", &cut);
}

#[test]
fn no_file_is_large() {
    let size = |path: &Path| std::fs::metadata(root().join(path)).unwrap().len();
    let large =
        files().into_iter().filter(|path| size(path) > LARGEST && !LARGER.iter().any(|known| path == Path::new(known)));
    let large: Vec<_> = large.map(|path| format!("{}: {} bytes", path.display(), size(&path))).collect();
    assert_none("No file is larger than 1 MiB", &large);
    let gone: Vec<_> = LARGER.iter().filter(|path| !root().join(path).exists()).map(|&path| path.to_owned()).collect();
    assert_none("No exception for a file that is gone", &gone);
}

#[cfg(test)]
mod rules {
    use super::*;

    #[test]
    fn paths_of_one_machine_are_found() {
        for line in [
            r#"let path = "/home/someone/recording";"#,
            "see /Users/someone/notes.md",
            r#"r"C:\Users\someone\x""#,
            "cd /checkouts/itm/out",
        ] {
            assert!(machine_specific(line, "/checkouts/itm"), "{line}");
        }
        for line in ["https://example.org/home/page", "/usr/share/vulkan", "~/home/x", "/homes/x", "$ROOT/root/x"] {
            assert!(!machine_specific(line, "/checkouts/itm"), "{line}");
        }
    }

    #[test]
    fn unfinished_code_is_found() {
        assert!(unfinished(concat!("    todo", "!(\"later\")")));
        assert!(unfinished(concat!("#[", "ignore = \"slow\"]")));
        assert!(!unfinished(concat!("// never write todo", "!()")));
    }

    #[test]
    fn shader_text_is_found_outside_comments() {
        assert!(shader_text("    \"@compute @workgroup_size(64) fn main() {}\","));
        assert!(!shader_text("/// The entry point marked @compute."));
    }

    #[test]
    fn words_are_found_whole() {
        assert!(contains_word("use wgpu::Device;", "wgpu"));
        assert!(!contains_word("let wgpu_free = 1;", "wgpu") && !contains_word("mywgpu", "wgpu"));
    }

    #[test]
    fn places_are_named_by_file_and_line() {
        let texts = [(PathBuf::from("a.rs"), "one\n  two\n".to_owned())];
        assert_eq!(lines_where(&texts, |line| line.contains("two")), ["a.rs:2: two"]);
    }
}
