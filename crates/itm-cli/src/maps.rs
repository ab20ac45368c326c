//! What the commands on saved maps have in common.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use itm_slam::{Device, SavedMap, SavedSession, Slam};

use crate::console;

/// Bytes of a mebibyte.
pub(crate) const MIB: u64 = 1 << 20;

/// Opens a map that holds something, keeping so many MiB of it in memory.
pub(crate) fn open(path: &Path, memory_mib: u64, quiet: bool) -> Result<SavedMap> {
    let bar = console::bar(0, "MiB of the map read", quiet);
    let map = SavedMap::open(path, memory_mib.saturating_mul(MIB), &mut |done, all| {
        bar.set_length(all / MIB);
        bar.set_position(done / MIB);
    });
    bar.finish_and_clear();
    let map = map?;
    if map.blocks() == 0 {
        bail!("the map '{}' is empty: it holds no blocks", path.display());
    }
    Ok(map)
}

/// The session that made a map of surfels; none where it is one of voxels.
pub(crate) fn of_surfels(path: &Path, device: Option<&str>) -> Result<Option<Slam>> {
    // What is wrong with a file is told by what reads all of it.
    let Some(saved) = SavedSession::open(path).ok().filter(|saved| saved.settings.mode.has_surfels()) else {
        return Ok(None);
    };
    let device = match device {
        Some(asked) => Device::open(asked)?,
        // That machine may have had another one.
        None => Device::open(&saved.settings.device.adapter).or_else(|_| Device::open("auto"))?,
    };
    let slam = Slam::resume(&device, path)?;
    if slam.surfels()?.is_empty() {
        bail!("the map '{}' is empty: it holds no stable surfels", path.display());
    }
    Ok(Some(slam))
}

/// Checks that a map has blocks of a submap.
pub(crate) fn check_submap(map: &SavedMap, submap: u16) -> Result<()> {
    let submaps = map.submaps();
    if !submaps.contains(&submap) {
        bail!("the map '{}' has no submap {submap}; it has {submaps:?}", map.path().display());
    }
    Ok(())
}

/// The device asked for, or else the one of the run that made the map.
pub(crate) fn device(asked: Option<&str>, map: &SavedMap) -> Result<Device> {
    let of_run = map.settings().ok().map(|settings| settings.device.adapter);
    match (asked, of_run) {
        (Some(asked), _) => Ok(Device::open(asked)?),
        // That machine may have had another one.
        (None, Some(of_run)) => Ok(Device::open(&of_run).or_else(|_| Device::open("auto"))?),
        (None, None) => Ok(Device::open("auto")?),
    }
}

/// Checks that a file can come to be in its folder, before any work goes into it.
pub(crate) fn check_folder_of(path: &Path) -> Result<()> {
    if path.is_dir() {
        bail!("the output '{}' is a folder; name a file", path.display());
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            bail!("the folder '{}' of the output does not exist", folder.display())
        }
        _ => Ok(()),
    }
}

/// Numbers with commas between, as many as asked for.
pub(crate) fn numbers<const N: usize>(text: &str) -> Result<[f64; N]> {
    let expected = || format!("expected {N} finite numbers with commas between, not '{text}'");
    let values: Result<Vec<f64>, _> = text.split(',').map(|word| word.trim().parse::<f64>()).collect();
    let values: [f64; N] = values.ok().and_then(|v| v.try_into().ok()).with_context(expected)?;
    if !values.iter().all(|v| v.is_finite()) {
        bail!(expected());
    }
    Ok(values)
}
