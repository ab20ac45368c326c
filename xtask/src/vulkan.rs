//! Whether this Linux machine has a Vulkan loader and a driver, found from files alone.
//!
//! This is what can be known before anything is built; `itm devices` asks the drivers themselves. The folders are those
//! of *Driver interface to the Vulkan Loader*, section *Driver Discovery on Linux*.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The loader's soname, which wgpu opens at run time.
const LOADER: &str = "libvulkan.so.1";

/// Beginnings of the manifest names of drivers that run on the CPU: Mesa's lavapipe, SwiftShader.
const SOFTWARE: [&str; 2] = ["lvp_icd", "vk_swiftshader"];

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Vulkan {
    /// Whether the loader library is installed.
    pub(crate) loader: bool,
    /// Manifests of drivers that the loader would try.
    pub(crate) manifests: Vec<PathBuf>,
    /// Whether the kernel shows a GPU, without which a hardware driver offers no adapter.
    pub(crate) gpu: bool,
    /// The environment variable that takes the place of the usual folders, where one is set.
    pub(crate) overridden_by: Option<&'static str>,
}

impl Vulkan {
    /// What this machine has.
    pub(crate) fn of_this_machine() -> Self {
        let places = Places {
            root: Path::new("/"),
            variable: &|name| std::env::var_os(name).filter(|value| !value.is_empty()),
            linker_cache: &linker_cache(),
        };
        places.search()
    }

    /// The manifest of a driver that runs on the CPU.
    pub(crate) fn software_driver(&self) -> Option<&Path> {
        self.manifests.iter().map(PathBuf::as_path).find(|manifest| is_software(manifest))
    }

    /// The manifest of a driver for a GPU, where the kernel shows one.
    pub(crate) fn hardware_driver(&self) -> Option<&Path> {
        self.manifests.iter().map(PathBuf::as_path).find(|manifest| self.gpu && !is_software(manifest))
    }

    /// Whether wgpu can be expected to find an adapter.
    pub(crate) fn is_ready(&self) -> bool {
        self.loader && (self.software_driver().is_some() || self.hardware_driver().is_some())
    }
}

fn is_software(manifest: &Path) -> bool {
    let name = manifest.file_name().unwrap_or_default().to_string_lossy();
    SOFTWARE.iter().any(|start| name.starts_with(start))
}

/// What `ldconfig` knows. Debian keeps it in a folder that is not on everyone's `PATH`.
fn linker_cache() -> String {
    ["ldconfig", "/sbin/ldconfig"]
        .into_iter()
        .filter_map(|program| Command::new(program).arg("-p").output().ok())
        .find(|output| output.status.success())
        .map_or_else(String::new, |output| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Where to search; the tests put a folder of their own in the place of `/`.
struct Places<'a> {
    root: &'a Path,
    variable: &'a dyn Fn(&str) -> Option<OsString>,
    linker_cache: &'a str,
}

impl Places<'_> {
    fn search(&self) -> Vulkan {
        // The newer name wins where both are set.
        let overridden_by =
            ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].into_iter().find(|name| (self.variable)(name).is_some());
        let mut manifests = Vec::new();
        for path in overridden_by.map_or_else(|| self.folders(), |name| self.paths(name)) {
            manifests.extend(manifests_at(&path));
        }
        for path in self.paths("VK_ADD_DRIVER_FILES") {
            manifests.extend(manifests_at(&path));
        }
        Vulkan { loader: self.has_loader(), manifests, gpu: self.has_gpu(), overridden_by }
    }

    /// The paths in the list that the variable `name` holds.
    fn paths(&self, name: &str) -> Vec<PathBuf> {
        (self.variable)(name).map_or_else(Vec::new, |list| std::env::split_paths(&list).collect())
    }

    /// The paths in the variable `name`, or those given, below the root, where it is not set.
    fn paths_or(&self, name: &str, defaults: &[&str]) -> Vec<PathBuf> {
        let paths = self.paths(name);
        if paths.is_empty() { defaults.iter().map(|path| self.root.join(path)).collect() } else { paths }
    }

    /// The folders of driver manifests, in the loader's order.
    fn folders(&self) -> Vec<PathBuf> {
        let own = |variable, below_home| {
            let home = || Some(PathBuf::from((self.variable)("HOME")?).join(below_home));
            (self.variable)(variable).map(PathBuf::from).or_else(home)
        };
        let mut folders = Vec::new();
        folders.extend(own("XDG_CONFIG_HOME", ".config"));
        folders.extend(self.paths_or("XDG_CONFIG_DIRS", &["etc/xdg"]));
        folders.extend([self.root.join("usr/local/etc"), self.root.join("etc")]);
        folders.extend(own("XDG_DATA_HOME", ".local/share"));
        folders.extend(self.paths_or("XDG_DATA_DIRS", &["usr/local/share", "usr/share"]));
        folders.iter().map(|folder| folder.join("vulkan/icd.d")).collect()
    }

    fn has_loader(&self) -> bool {
        let arch = std::env::consts::ARCH;
        let mut folders = self.paths("LD_LIBRARY_PATH");
        for folder in ["lib", "lib64", "usr/lib", "usr/lib64", "usr/local/lib"] {
            folders.push(self.root.join(folder));
        }
        folders.push(self.root.join(format!("usr/lib/{arch}-linux-gnu")));
        self.linker_cache.contains(LOADER) || folders.iter().any(|folder| folder.join(LOADER).exists())
    }

    fn has_gpu(&self) -> bool {
        let render_node = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with("renderD");
        let mut nodes = std::fs::read_dir(self.root.join("dev/dri")).into_iter().flatten().flatten();
        // The others: NVIDIA's own driver, Windows' GPUs in WSL, phone-like GPUs.
        let own_nodes = ["dev/nvidiactl", "dev/dxg", "dev/kgsl-3d0", "dev/mali0"];
        nodes.any(render_node) || own_nodes.iter().any(|node| self.root.join(node).exists())
    }
}

/// The manifests at `path`, which is one or a folder of them, sorted by name.
fn manifests_at(path: &Path) -> Vec<PathBuf> {
    let mut found: Vec<_> = if path.is_dir() {
        std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
    } else {
        vec![path.to_owned()]
    };
    found.retain(|file| file.is_file() && file.extension().is_some_and(|extension| extension == "json"));
    // Debian's 32-bit drivers, there for games beside the 64-bit ones, which no 64-bit program can load.
    found.retain(|file| !(cfg!(target_arch = "x86_64") && file.to_string_lossy().ends_with(".i686.json")));
    found.sort();
    found
}

#[cfg(test)]
#[cfg(unix)] // lists of paths are separated by colons there
mod tests {
    use std::collections::HashMap;

    use tempfile::TempDir;

    use super::*;

    /// A machine with the given files, all empty, and variables, in which `{root}` stands for its root.
    struct Machine {
        root: TempDir,
        variables: HashMap<&'static str, OsString>,
    }

    impl Machine {
        fn new(files: &[&str]) -> Self {
            let root = tempfile::tempdir().unwrap();
            for file in files {
                let path = root.path().join(file);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "").unwrap();
            }
            Self { root, variables: HashMap::new() }
        }

        fn with(mut self, name: &'static str, value: &str) -> Self {
            self.variables.insert(name, value.replace("{root}", self.root.path().to_str().unwrap()).into());
            self
        }

        fn search(&self) -> Vulkan {
            let variable = |name: &str| self.variables.get(name).cloned();
            Places { root: self.root.path(), variable: &variable, linker_cache: "" }.search()
        }

        /// The manifests that a search finds, as paths below the root.
        fn manifests(&self) -> Vec<String> {
            let below = |path: &PathBuf| path.strip_prefix(self.root.path()).unwrap().to_str().unwrap().to_owned();
            self.search().manifests.iter().map(below).collect()
        }
    }

    #[test]
    fn an_empty_machine_is_not_ready() {
        let found = Machine::new(&[]).search();
        assert_eq!(found, Vulkan { loader: false, manifests: vec![], gpu: false, overridden_by: None });
        assert!(!found.is_ready());
    }

    #[test]
    fn a_software_driver_needs_the_loader_and_no_gpu() {
        let manifest = "usr/share/vulkan/icd.d/lvp_icd.json";
        assert!(!Machine::new(&[manifest]).search().is_ready());
        assert!(Machine::new(&[manifest, "usr/lib/libvulkan.so.1"]).search().is_ready());
    }

    #[test]
    fn the_loader_is_also_found_through_the_linkers_cache_and_path() {
        let manifest = "etc/vulkan/icd.d/vk_swiftshader_icd.json";
        let machine = Machine::new(&[manifest]);
        let linker_cache = "\tlibvulkan.so.1 (libc6,x86-64) => elsewhere/libvulkan.so.1\n";
        assert!(Places { root: machine.root.path(), variable: &|_| None, linker_cache }.search().is_ready());
        let machine = Machine::new(&[manifest, "opt/sdk/libvulkan.so.1"]);
        assert!(!machine.search().is_ready());
        assert!(machine.with("LD_LIBRARY_PATH", "{root}/opt:{root}/opt/sdk").search().is_ready());
    }

    #[test]
    fn a_hardware_driver_needs_a_gpu() {
        let files = ["usr/share/vulkan/icd.d/nvidia_icd.json", "usr/lib64/libvulkan.so.1", "dev/nvidiactl"];
        assert!(!Machine::new(&files[..2]).search().is_ready());
        let found = Machine::new(&files).search();
        assert!(found.is_ready());
        assert_eq!(found.software_driver(), None);
        assert!(Machine::new(&[files[0], files[1], "dev/dri/renderD128"]).search().is_ready());
        // A display without a renderer, as on many servers.
        assert!(!Machine::new(&[files[0], files[1], "dev/dri/card0"]).search().is_ready());
    }

    #[test]
    fn all_the_usual_folders_are_searched_in_the_loaders_order() {
        let files = [
            "home/.config/vulkan/icd.d/a.json",
            "etc/xdg/vulkan/icd.d/b.json",
            "usr/local/etc/vulkan/icd.d/c.json",
            "etc/vulkan/icd.d/d.json",
            "home/.local/share/vulkan/icd.d/e.json",
            "usr/local/share/vulkan/icd.d/f.json",
            "usr/share/vulkan/icd.d/g.json",
        ];
        let machine = Machine::new(&files).with("HOME", "{root}/home");
        assert_eq!(machine.manifests(), files);
    }

    #[test]
    fn xdg_variables_take_the_place_of_their_defaults() {
        let files = ["usr/share/vulkan/icd.d/a.json", "one/vulkan/icd.d/b.json", "two/vulkan/icd.d/c.json"];
        let machine = Machine::new(&files).with("XDG_DATA_DIRS", "{root}/one").with("XDG_DATA_HOME", "{root}/two");
        assert_eq!(machine.manifests(), [files[2], files[1]]);
    }

    #[test]
    fn driver_variables_take_the_place_of_all_folders() {
        let files = ["usr/share/vulkan/icd.d/a.json", "own/b.json", "own/more/c.json"];
        let machine = Machine::new(&files).with("VK_ICD_FILENAMES", "{root}/own/b.json:{root}/own/more");
        assert_eq!(machine.manifests(), [files[1], files[2]]);
        assert_eq!(machine.search().overridden_by, Some("VK_ICD_FILENAMES"));
        let machine = machine.with("VK_DRIVER_FILES", "{root}/missing.json");
        assert!(machine.manifests().is_empty());
        assert_eq!(machine.search().overridden_by, Some("VK_DRIVER_FILES"));
    }

    #[test]
    fn added_drivers_come_beside_the_usual_ones() {
        let files = ["usr/share/vulkan/icd.d/a.json", "own/b.json"];
        let machine = Machine::new(&files).with("VK_ADD_DRIVER_FILES", "{root}/own");
        assert_eq!(machine.manifests(), files);
        assert_eq!(machine.search().overridden_by, None);
    }

    #[test]
    fn only_manifests_count() {
        let files = ["usr/share/vulkan/icd.d/readme.txt", "usr/share/vulkan/icd.d/folder.json/x"];
        assert!(Machine::new(&files).manifests().is_empty());
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn drivers_for_32_bit_programs_do_not_count() {
        assert!(Machine::new(&["usr/share/vulkan/icd.d/lvp_icd.i686.json"]).manifests().is_empty());
    }
}
