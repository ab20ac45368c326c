//! `itm info`.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use glam::IVec3;
use itm_core::voxel::{BLOCK_SIDE, BlockKey, DistanceKind, VoxelKind};
use itm_core::{Calibration, Intrinsics, Se3, Trajectory};
use itm_io::map_file::{MapReader, SubmapPose, tag};
use itm_slam::Error;
use serde::Serialize;

use crate::console;
use crate::maps::MIB;

/// Say what a saved map holds, and check that it is undamaged
///
/// The whole file is read, and every checksum checked. No graphics adapter is needed.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm info room.itm
  itm info room.itm --json

Exit status: 0 undamaged, 1 damaged or no map, 2 bad command line.")]
pub(crate) struct Arguments {
    /// The map file
    map: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Info {
    file: PathBuf,
    file_bytes: u64,
    /// Major and minor.
    format_version: (u16, u16),
    generator: String,
    calibration: Calibration,
    voxel_kind: VoxelKind,
    voxel_size_m: f32,
    truncation_m: f32,
    frames: u64,
    device_blocks: u64,
    host_blocks: u64,
    /// Different ones: a block may be on both sides.
    blocks: usize,
    /// Those that have blocks or a pose, by their numbers.
    submaps: Vec<Submap>,
    /// Bytes of all voxels.
    voxel_bytes: u64,
    /// Lower and upper corner of all blocks.
    bounds_m: Option<[[f64; 3]; 2]>,
    poses: usize,
    trajectory_seconds: f64,
    trajectory_length_m: f64,
    /// Of a map of surfels.
    surfels: Option<u64>,
    sections: Vec<Section>,
}

#[derive(Serialize)]
struct Submap {
    submap: u16,
    blocks: u64,
    /// Of a map of surfels.
    #[serde(skip_serializing_if = "Option::is_none")]
    surfels: Option<u64>,
    /// `null` where the file says where others are, but not this one.
    world_from_submap: Option<Se3>,
}

#[derive(Serialize)]
struct Section {
    tag: String,
    bytes: u64,
    compressed_bytes: u64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let path = &arguments.map;
    let mut reader = MapReader::open(path)?;
    reader.verify()?;
    let file_bytes = std::fs::metadata(path).with_context(|| format!("cannot read '{}'", path.display()))?.len();
    let mut keys = HashSet::new();
    let mut count = |tag| -> Result<u64, Error> {
        let mut used = 0;
        if reader.has(tag) {
            reader.blocks::<Error>(tag, |key, _| {
                used += u64::from(key.is_some());
                keys.extend(key);
                Ok(())
            })?;
        }
        Ok(used)
    };
    let (device_blocks, host_blocks) = (count(tag::BLOCKS)?, count(tag::HOST_BLOCKS)?);
    let trajectory = if reader.has(tag::TRAJECTORY) { reader.trajectory()? } else { Trajectory::default() };
    let poses_of_submaps = reader.submaps()?;
    let surfels = itm_slam::count_surfels(&mut reader)?;
    let mut submaps = submaps_of(&keys, &poses_of_submaps);
    if let Some(counts) = &surfels {
        submaps.iter_mut().for_each(|submap| submap.surfels = Some(counts.get(&submap.submap).copied().unwrap_or(0)));
    }
    let header = reader.header().clone();
    let block_m = f64::from(header.voxel_size_m) * f64::from(BLOCK_SIDE);
    let bounds = keys.iter().map(|k| (k.position, k.position)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let corner = |position: IVec3| (position.as_dvec3() * block_m).to_array();
    let poses = trajectory.poses();
    let steps = poses.windows(2);
    let info = Info {
        file: path.clone(),
        file_bytes,
        format_version: reader.version(),
        generator: header.generator,
        calibration: header.calibration,
        voxel_kind: header.voxel_kind,
        voxel_size_m: header.voxel_size_m,
        truncation_m: header.truncation_m,
        frames: header.counts.frames,
        device_blocks,
        host_blocks,
        blocks: keys.len(),
        submaps,
        voxel_bytes: keys.len() as u64 * header.voxel_kind.block_bytes(),
        bounds_m: bounds.map(|(first, last)| [corner(first), corner(last + 1)]),
        poses: poses.len(),
        trajectory_seconds: match poses {
            [first, .., last] => (last.timestamp.0 - first.timestamp.0) as f64 * 1e-9,
            _ => 0.0,
        },
        trajectory_length_m: steps
            .map(|w| w[0].world_from_camera.translation.distance(w[1].world_from_camera.translation))
            .fold(0.0, |sum, step| sum + step),
        surfels: surfels.map(|counts| counts.into_values().sum()),
        sections: reader
            .sections()
            .map(|s| Section {
                tag: s.tag.escape_ascii().to_string(),
                bytes: s.raw_bytes,
                compressed_bytes: s.stored_bytes,
            })
            .collect(),
    };
    if arguments.json {
        console::print_json(&info)?
    } else {
        console::print(&info)?
    }
    Ok(0)
}

/// How many blocks each submap has, and where it lies.
fn submaps_of(keys: &HashSet<BlockKey>, poses: &[SubmapPose]) -> Vec<Submap> {
    let mut blocks: BTreeMap<u16, u64> = poses.iter().map(|pose| (pose.submap, 0)).collect();
    keys.iter().for_each(|key| *blocks.entry(key.submap).or_default() += 1);
    let pose = |submap| match poses {
        [] => Some(Se3::IDENTITY),
        poses => poses.iter().find(|pose| pose.submap == submap).map(|pose| pose.world_from_submap),
    };
    let submap = |(submap, blocks)| Submap { submap, blocks, surfels: None, world_from_submap: pose(submap) };
    blocks.into_iter().map(submap).collect()
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mib = |bytes: u64| bytes as f64 / MIB as f64;
        let (major, minor) = self.format_version;
        writeln!(f, "{}: map format {major}.{minor} by {}, undamaged", self.file.display(), self.generator)?;
        let camera = |c: &Intrinsics| format!("{}x{}, focal lengths {:.1} and {:.1}", c.width, c.height, c.fx, c.fy);
        writeln!(
            f,
            "cameras     depth {}; colour {}",
            camera(&self.calibration.depth),
            camera(&self.calibration.colour)
        )?;
        let distance = match self.voxel_kind.distance {
            DistanceKind::I16 => "16-bit distances",
            DistanceKind::F32 => "float distances",
        };
        let colour = if self.voxel_kind.colour { ", colours" } else { "" };
        let confidence = if self.voxel_kind.confidence { ", confidences" } else { "" };
        let (size_mm, band_mm) = (1e3 * self.voxel_size_m, 1e3 * self.truncation_m);
        writeln!(f, "voxels      {size_mm} mm, truncated at {band_mm} mm: {distance}{colour}{confidence}")?;
        let Self { blocks, device_blocks, host_blocks, .. } = self;
        let in_memory = mib(self.voxel_bytes);
        writeln!(
            f,
            "blocks      {blocks} ({device_blocks} from the device, {host_blocks} from the host): {in_memory:.1} MiB"
        )?;
        if let Some(surfels) = self.surfels {
            writeln!(f, "surfels     {surfels}")?;
        }
        if self.submaps.len() > 1 {
            writeln!(f, "submaps     {}", self.submaps.len())?;
            for Submap { submap, blocks, surfels, world_from_submap } in &self.submaps {
                match surfels {
                    Some(surfels) => write!(f, "  {submap:<9} {surfels} surfels, ")?,
                    None => write!(f, "  {submap:<9} {blocks} blocks, ")?,
                }
                match world_from_submap {
                    Some(pose) => {
                        let ([x, y, z], degrees) = (pose.translation.to_array(), pose.angle().to_degrees());
                        writeln!(f, "at {x:.2}, {y:.2}, {z:.2} m in the world, turned by {degrees:.1} degrees")?;
                    }
                    None => writeln!(f, "without a pose in the world")?,
                }
            }
        }
        if let Some([[ax, ay, az], [bx, by, bz]]) = self.bounds_m {
            writeln!(f, "bounds      {ax:.2}, {ay:.2}, {az:.2} to {bx:.2}, {by:.2}, {bz:.2} m")?;
        }
        let Self { frames, poses, trajectory_length_m: length, trajectory_seconds: seconds, .. } = self;
        writeln!(f, "trajectory  {poses} poses of {frames} frames, {length:.2} m in {seconds:.1} s")?;
        write!(f, "file        {:.2} MiB", mib(self.file_bytes))?;
        for Section { tag, bytes, compressed_bytes } in &self.sections {
            write!(f, "\n  {tag}      {:.2} MiB, compressed {:.2} MiB", mib(*bytes), mib(*compressed_bytes))?;
        }
        Ok(())
    }
}
