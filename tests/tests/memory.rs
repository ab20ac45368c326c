//! Memory goes with blocks, not with submaps.

use glam::IVec3;
use itm_io::block_store::{BlockStore, Placed, StoreFile};
use itm_io::map_file::{BlockSink, MapHeader, MapWriter, SubmapPose, tag};
use itm_slam::voxel::{BlockKey, ColourVoxel, DistanceKind, DistanceVoxel, VoxelKind};
use itm_slam::{Calibration, DepthConversion, Intrinsics, Mode, Se3, Settings, Slam, SubmapState, Swapping};
use itm_tests::device;

fn settings() -> Settings {
    let mut settings = Settings { mode: Mode::LoopClosure, ..Settings::default() };
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings
}

/// A map whose blocks are in so many submaps, each as large as the others.
fn write_blocks(path: &std::path::Path, settings: &Settings, camera: Intrinsics, submaps: u16) {
    let kind = VoxelKind { distance: DistanceKind::I16, colour: true, confidence: false };
    let header = MapHeader::new(settings, Calibration::registered(camera, DepthConversion::MILLIMETRES), kind);
    let mut writer = MapWriter::create(path, &header).expect("a new file");
    let blocks = |sink: &mut BlockSink<'_, '_>| -> Result<(), itm_io::Error> {
        for i in 0..BLOCKS {
            // A slab of voxels, with noise, as sensors leave it: so it matters little to compression which blocks are neighbours.
            let noise = |v: i32| {
                let mixed = |bits: u32, by: u32| (bits ^ (bits >> 15)).wrapping_mul(by);
                mixed(mixed((i * 512 + v) as u32, 0x7feb_352d), 0x846c_a68b) >> 20
            };
            let voxel = |v: i32| {
                let distance = ((v >> 6) as f32 - 4.0 + noise(v) as f32 / 4096.0) / 4.0;
                DistanceVoxel::new(distance, 1 + (v % 50) as u16).0
            };
            let colour = |v: i32| ColourVoxel::new([(noise(v) >> 5) as u8, (v % 200) as u8, (v >> 5) as u8], 9).0;
            let words: Vec<u32> = (0..512).map(voxel).chain((0..512).map(colour)).collect();
            let submap = (i * i32::from(submaps) / BLOCKS) as u16;
            let position = IVec3::new(i % 20, i / 20 % 20, i / 400);
            sink.block(BlockKey { submap, position }, &words)?;
        }
        Ok(())
    };
    writer.blocks(tag::BLOCKS, blocks).expect("written");
    let submap = |submap| SubmapPose { submap, world_from_submap: Se3::IDENTITY, state: SubmapState::Passive };
    writer.submaps(&(0..submaps).map(submap).collect::<Vec<_>>()).expect("written");
    writer.finish().expect("written");
}

const BLOCKS: i32 = 4000;

/// Memory goes with blocks: ten submaps take what one of as many blocks does, on the device, in the host's store and in files.
#[test]
fn ten_submaps_take_the_memory_of_one() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let camera = Intrinsics::new(160, 120, 131.25, 131.25, 79.5, 59.5);
    let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
    let measure = |submaps: u16, swapping: Swapping| {
        let mut settings = settings();
        settings.map.swapping = swapping;
        let path = folder.path().join("blocks.itm");
        write_blocks(&path, &settings, camera, submaps);
        let start = Se3::exp([1.6, 1.6, -2.0, 0.0, 0.0, 0.0]);
        let mut slam = Slam::in_map(&device, &calibration, &settings, &path, Some(&start)).expect("taken in");
        assert_eq!(slam.submaps().len(), usize::from(submaps));
        assert_eq!(slam.blocks().expect("keys").len(), BLOCKS as usize);
        slam.save(&path).expect("saved");
        let file = std::fs::metadata(&path).expect("a file").len();
        (slam.map_bytes(), slam.stored_blocks(), file)
    };
    let block_bytes = 8 * 512;
    let near = |one: u64, ten: u64, whole: u64| ten.abs_diff(one) * 10 <= whole;
    // With all blocks on the device, without the grid and what else there is once.
    let ((one, _, one_file), (ten, _, ten_file)) = (measure(1, Swapping::Off), measure(10, Swapping::Off));
    assert!(one >= BLOCKS as u64 * block_bytes && near(one, ten, BLOCKS as u64 * block_bytes), "{one} and {ten} bytes");
    assert!(near(one_file, ten_file, one_file), "files of {one_file} and {ten_file} bytes");
    // In the host's store, and those in view on the device.
    let ((.., one_file), (.., ten_file)) = (measure(1, Swapping::Host), measure(10, Swapping::Host));
    assert!(near(one_file, ten_file, one_file), "files of {one_file} and {ten_file} bytes");
    let stored = |submaps: i32| {
        let mut store = BlockStore::new(1024, u64::MAX, StoreFile::Temporary(None));
        for i in 0..BLOCKS {
            let (submap, position) = ((i * submaps / BLOCKS) as u16, IVec3::new(i % 20, i / 20 % 20, i / 400));
            assert_eq!(store.put(BlockKey { submap, position }, &[1; 1024]), Placed::WithinBudget);
        }
        store.memory_bytes()
    };
    assert!(stored(1) > 0 && near(stored(1), stored(10), stored(1)), "{} and {} bytes", stored(1), stored(10));
}
