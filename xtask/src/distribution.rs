//! Which Linux distribution this is, and how its users install the software Vulkan driver.

/// A family of Linux distributions that share a package manager and package names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Distribution {
    Debian,
    Fedora,
    Arch,
    OpenSuse,
    Unknown,
}

impl Distribution {
    /// Reads the text of `/etc/os-release`: `ID` decides, then `ID_LIKE` from left to right (derivatives name there
    /// what they are made from, the nearest first).
    pub(crate) fn from_os_release(text: &str) -> Self {
        let ids =
            value(text, "ID").into_iter().chain(value(text, "ID_LIKE").into_iter().flat_map(str::split_whitespace));
        ids.map(Self::from_id).find(|&family| family != Self::Unknown).unwrap_or(Self::Unknown)
    }

    /// The distribution that this program runs on.
    pub(crate) fn of_this_machine() -> Self {
        // os-release(5): the second is what a package ships, the first what an administrator may have changed.
        let text =
            std::fs::read_to_string("/etc/os-release").or_else(|_| std::fs::read_to_string("/usr/lib/os-release"));
        text.map_or(Self::Unknown, |text| Self::from_os_release(&text))
    }

    /// The packages with the Vulkan loader and Mesa's drivers, the software driver lavapipe among them.
    pub(crate) fn packages(self) -> &'static [&'static str] {
        match self {
            Self::Debian => &["mesa-vulkan-drivers", "libvulkan1"],
            Self::Fedora => &["mesa-vulkan-drivers", "vulkan-loader"],
            Self::Arch => &["vulkan-swrast", "vulkan-icd-loader"],
            Self::OpenSuse => &["libvulkan_lvp", "libvulkan1"],
            Self::Unknown => &[],
        }
    }

    /// What a user types to install [`Self::packages`], line by line; nothing where that is not known.
    pub(crate) fn commands(self) -> Vec<String> {
        let packages = self.packages().join(" ");
        match self {
            Self::Debian => vec![
                "sudo apt-get update".to_owned(),
                format!("sudo apt-get install --no-install-recommends {packages}"),
            ],
            Self::Fedora => vec![format!("sudo dnf install {packages}")],
            Self::Arch => vec![format!("sudo pacman -S --needed {packages}")],
            Self::OpenSuse => vec![format!("sudo zypper install {packages}")],
            Self::Unknown => Vec::new(),
        }
    }

    fn from_id(id: &str) -> Self {
        match id {
            "debian" | "ubuntu" => Self::Debian,
            "fedora" => Self::Fedora,
            "arch" => Self::Arch,
            "suse" | "opensuse" => Self::OpenSuse,
            id if id.starts_with("opensuse-") => Self::OpenSuse,
            _ => Self::Unknown,
        }
    }
}

/// The value of `key` in os-release's shell-like lines, without its quotes.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let line = text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix('='))?;
    Some(line.trim_matches(['"', '\'']))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, expected: Distribution) {
        assert_eq!(Distribution::from_os_release(text), expected, "{text}");
    }

    #[test]
    fn families_are_told_from_os_release() {
        check("PRETTY_NAME=\"Debian GNU/Linux 12 (bookworm)\"\nVERSION_ID=\"12\"\nID=debian\n", Distribution::Debian);
        check("NAME=\"Ubuntu\"\nID=ubuntu\nID_LIKE=debian\nUBUNTU_CODENAME=noble\n", Distribution::Debian);
        check("NAME=\"Fedora Linux\"\nID=fedora\nVARIANT_ID=workstation\n", Distribution::Fedora);
        check("NAME=\"Arch Linux\"\nID=arch\nBUILD_ID=rolling\n", Distribution::Arch);
        check("ID=\"opensuse-tumbleweed\"\nID_LIKE=\"opensuse suse\"\n", Distribution::OpenSuse);
        check("ID=\"opensuse-leap\"\nID_LIKE=\"suse opensuse\"\n", Distribution::OpenSuse);
    }

    #[test]
    fn derivatives_are_told_from_id_like() {
        check("ID=linuxmint\nID_LIKE=\"ubuntu debian\"\n", Distribution::Debian);
        check("ID=\"rocky\"\nID_LIKE=\"rhel centos fedora\"\n", Distribution::Fedora);
        check("ID=manjaro\nID_LIKE=arch\n", Distribution::Arch);
        check("ID='sles'\nID_LIKE='suse'\n", Distribution::OpenSuse);
    }

    #[test]
    fn keys_that_only_look_like_id_are_not_it() {
        check("VARIANT_ID=debian\nBUILD_ID=arch\nID=gentoo\n", Distribution::Unknown);
        check("", Distribution::Unknown);
    }

    #[test]
    fn every_known_family_has_commands_that_name_its_packages() {
        use Distribution::{Arch, Debian, Fedora, OpenSuse, Unknown};
        for family in [Debian, Fedora, Arch, OpenSuse] {
            let commands = family.commands();
            let install = commands.last().unwrap();
            assert!(family.packages().iter().all(|package| install.contains(package)), "{install}");
        }
        assert!(Unknown.commands().is_empty() && Unknown.packages().is_empty());
    }
}
