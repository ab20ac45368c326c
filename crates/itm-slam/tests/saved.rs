//! Saved maps: opened, meshed in chunks and looked at, against the same map as a whole on the device.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::path::Path;

use glam::{DVec2, DVec3, IVec3, Vec3};
use itm_gpu::mesh::{Extract, Options};
use itm_gpu::reference::Block;
use itm_gpu::{BlockMap, HostBlock};
use itm_io::map_file::{MapHeader, MapWriter, tag};
use itm_slam::voxel::{BlockKey, ColourVoxel, DistanceVoxel, VoxelKind};
use itm_slam::{
    BlockSource, Calibration, DepthConversion, Device, Intrinsics, MapViews, Mesh, MeshOptions, SavedMap, Scale, Se3,
    Settings, Shading, StampedPose, Timestamp, Trajectory, mesh_in_chunks,
};

const VOXEL_M: f32 = 1.0 / 128.0;
const BAND_VOXELS: f32 = 5.0;
const KIND: VoxelKind = VoxelKind { distance: itm_slam::voxel::DistanceKind::I16, colour: true, confidence: true };

type Blocks = Vec<(BlockKey, Vec<u32>)>;

/// The device; `None` where the environment variable `ITM_SKIP_GPU_TESTS` is set.
#[expect(clippy::print_stdout, reason = "a test that checks nothing says so")]
fn device() -> Option<Device> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        println!("skipped, because ITM_SKIP_GPU_TESTS is set");
        return None;
    }
    Some(Device::open("auto").expect("GPU tests need an adapter; a software driver will do"))
}

/// A sphere, in voxels, as the blocks around its surface.
fn sphere(submap: u16, centre: Vec3, radius: f32) -> Blocks {
    let reach = (radius / 8.0) as i32 + 3;
    let middle = (centre / 8.0).floor().as_ivec3();
    let side = || -reach..reach;
    let mut blocks = Vec::new();
    for offset in side().flat_map(|z| side().flat_map(move |y| side().map(move |x| IVec3::new(x, y, z)))) {
        let position = middle + offset;
        if (((position * 8).as_vec3() + 3.5).distance(centre) - radius).abs() > BAND_VOXELS + 6.1 {
            continue;
        }
        let mut block = Block::default();
        for i in 0..512_usize {
            let at = (position * 8 + IVec3::new(i as i32 & 7, i as i32 >> 3 & 7, i as i32 >> 6)).as_vec3();
            block.distances[i] = DistanceVoxel::new((at.distance(centre) - radius) / BAND_VOXELS, 7);
            let [r, g, b] = ((at - centre) / radius * 100.0 + 128.0).to_array().map(|c| c as u8);
            block.colours[i] = ColourVoxel::new([r, g, b], 3);
            block.confidences[i] = 2.5;
        }
        blocks.push((BlockKey { submap, position }, block.to_words(KIND)));
    }
    blocks
}

fn camera() -> Intrinsics {
    Intrinsics::new(160, 120, 150.0, 150.0, 79.5, 59.5)
}

fn header() -> MapHeader {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = VOXEL_M;
    settings.map.truncation_m = BAND_VOXELS * VOXEL_M;
    MapHeader::new(&settings, Calibration::registered(camera(), DepthConversion::MILLIMETRES), KIND)
}

/// Writes a map of blocks on the device, in the host's store, and on their way there.
fn write(path: &Path, device: &Blocks, host: &Blocks, left: &Blocks) {
    let mut writer = MapWriter::create(path, &header()).unwrap();
    for (tag, blocks) in [(tag::BLOCKS, device), (tag::HOST_BLOCKS, host), (*b"LEFT", left)] {
        let section = |sink: &mut itm_io::map_file::BlockSink<'_, '_>| -> Result<(), itm_io::Error> {
            sink.unused()?;
            blocks.iter().try_for_each(|(key, words)| sink.block(*key, words))
        };
        if !blocks.is_empty() {
            writer.blocks(tag, section).unwrap();
        }
    }
    let pose = StampedPose { timestamp: Timestamp(5), world_from_camera: Se3::IDENTITY };
    writer.trajectory(&[pose].into_iter().collect::<Trajectory>()).unwrap();
    writer.finish().unwrap();
}

fn open(blocks: &Blocks, budget_bytes: u64) -> SavedMap {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.itm");
    let (device, host) = blocks.split_at(blocks.len() / 2);
    let (host, left) = host.split_at(host.len() / 2);
    write(&path, &device.to_vec(), &host.to_vec(), &left.to_vec());
    SavedMap::open(&path, budget_bytes, &mut |done, all| assert!(done <= all)).unwrap()
}

fn whole(device: &Device, map: &SavedMap, blocks: &Blocks) -> BlockMap {
    let mut whole = BlockMap::new(device, map.layout(), 1).unwrap();
    let blocks: Vec<_> = blocks.iter().map(|(key, words)| HostBlock { key: *key, words }).collect();
    whole.insert_blocks(&blocks).unwrap();
    whole
}

type Corner = ([u32; 3], [u32; 3], [u8; 3], u16, u32);

/// The triangles with all that their corners have, to the bit, each starting with its smallest corner.
fn canonical(mesh: &Mesh) -> Vec<[Corner; 3]> {
    let corner = |v: u32| {
        let v = v as usize;
        let bits = |v: Vec3| v.to_array().map(f32::to_bits);
        let confidence = mesh.confidences[v].to_bits();
        (bits(mesh.positions[v]), bits(mesh.normals[v]), mesh.colours[v], mesh.weights[v], confidence)
    };
    let turned = |t: &[u32; 3]| {
        let mut t = t.map(corner);
        let smallest = (0..3).min_by_key(|&i| t[i]).unwrap();
        t.rotate_left(smallest);
        t
    };
    let mut triangles: Vec<_> = mesh.triangles.iter().map(turned).collect();
    triangles.sort_unstable();
    triangles
}

#[test]
fn a_mesh_in_chunks_is_the_mesh_of_the_whole_and_has_no_seam() {
    let Some(device) = device() else { return };
    // Across the origin, where blocks' numbers change sign, with vertices on blocks' borders.
    let blocks = sphere(0, Vec3::new(3.0, -2.25, 5.5), 44.0);
    let mut map = open(&blocks, 0);
    assert_eq!(map.blocks(), blocks.len());
    assert!(blocks.len() > 300, "{}", blocks.len());
    let expected =
        Extract::new(&device).run(&whole(&device, &map, &blocks), &Options::default(), &mut |_, _| ()).unwrap();
    for max_blocks in [27, 64, 250, 16_384] {
        let mut told = Vec::new();
        let options = MeshOptions { max_blocks, ..MeshOptions::default() };
        let mesh = map.mesh(&device, &options, &mut |done, all| told.push((done, all))).unwrap();
        assert!(mesh.is_watertight(), "with chunks of {max_blocks}");
        assert_eq!(mesh.positions.len(), expected.positions.len(), "with chunks of {max_blocks}");
        assert!(canonical(&mesh) == canonical(&expected), "other triangles with chunks of {max_blocks}");
        assert!(told.is_sorted() && told.last() == Some(&(blocks.len() as u64, blocks.len() as u64)), "{told:?}");
    }
    assert!(expected.confidences.iter().all(|c| *c == 2.5));
}

#[test]
fn random_voxels_with_zeros_are_joined_edge_by_edge() {
    let Some(device) = device() else { return };
    // Distances of zero put several edges' vertices in one place; they stay several. Some voxels were never seen.
    let mut state = 1_u32;
    let mut random = move || {
        state = state.wrapping_mul(0x0019_660d).wrapping_add(0x3c6e_f35f);
        state >> 8
    };
    let mut blocks = sphere(0, Vec3::splat(0.3), 14.0);
    for (_, words) in &mut blocks {
        for word in &mut words[..512] {
            let weight = u16::from(random() % 20 != 0);
            *word = DistanceVoxel::new((random() % 201) as f32 / 100.0 - 1.0, weight).0;
        }
    }
    let mut map = open(&blocks, 1 << 30);
    let expected =
        Extract::new(&device).run(&whole(&device, &map, &blocks), &Options::default(), &mut |_, _| ()).unwrap();
    let mesh = map.mesh(&device, &MeshOptions { min_weight: 1, max_blocks: 27 }, &mut |_, _| ()).unwrap();
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (expected.positions.len(), expected.triangles.len()));
    assert!(canonical(&mesh) == canonical(&expected));
    assert_eq!(mesh.boundary_edges().len(), expected.boundary_edges().len());
}

#[test]
fn submaps_are_meshed_each_on_its_own() {
    let Some(device) = device() else { return };
    let (a, b) = (sphere(0, Vec3::splat(0.2), 12.0), sphere(7, Vec3::splat(6.0), 15.0));
    let mut map = open(&[a.clone(), b.clone()].concat(), 1 << 30);
    assert_eq!(map.submaps(), [0, 7]);
    let mesh = mesh_in_chunks(&device, &mut map, &MeshOptions::default(), &mut |_, _| ()).unwrap();
    let alone = |blocks: &Blocks| {
        let mesh = open(blocks, 0).mesh(&device, &MeshOptions::default(), &mut |_, _| ()).unwrap();
        canonical(&mesh)
    };
    let mut expected = [alone(&a), alone(&b)].concat();
    expected.sort_unstable();
    assert!(mesh.is_watertight() && canonical(&mesh) == expected);
    let of_b = map.mesh_submap(7, &device, &MeshOptions::default(), &mut |_, _| ()).unwrap();
    assert!(canonical(&of_b) == alone(&b));
    // Seen each on its own, too.
    let seen = |map: &mut SavedMap, submap| {
        let mut views = MapViews::new(&device, map.layout(), submap, 1000).unwrap();
        let pose = Se3::new(glam::DQuat::IDENTITY, DVec3::new(0.0, 0.0, -0.5));
        views.look(map, &camera(), &pose, 2.0).unwrap();
        views.points().unwrap().positions.len()
    };
    let (of_a, of_b, of_none) = (seen(&mut map, 0), seen(&mut map, 7), seen(&mut map, 3));
    assert!(of_b > of_a && of_a > 100 && of_none == 0, "{of_a}, {of_b}, {of_none} pixels");
}

#[test]
fn a_block_on_both_sides_is_merged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("both.itm");
    let words = |distance, weight| {
        let mut words = vec![DistanceVoxel::new(distance, weight).0; 512];
        words.resize(KIND.block_words(), 0);
        words
    };
    let key = BlockKey { submap: 0, position: IVec3::new(-1, 2, 3) };
    write(&path, &vec![(key, words(0.25, 90))], &vec![(key, words(-0.25, 30))], &Vec::new());
    let mut map = SavedMap::open(&path, 0, &mut |_, _| ()).unwrap();
    assert_eq!((map.blocks(), map.keys()), (1, vec![key]));
    let mut merged = vec![0; KIND.block_words()];
    map.read(&[key], &mut merged).unwrap();
    let voxel = DistanceVoxel(merged[0]);
    assert!((voxel.distance() - 0.125).abs() < 1e-4, "{}", voxel.distance());
    assert_eq!(voxel.weight(), map.settings().unwrap().map.max_weight);
    let block_m = f64::from(8.0 * VOXEL_M);
    assert_eq!(map.bounds(), Some([DVec3::new(-1.0, 2.0, 3.0) * block_m, DVec3::new(0.0, 3.0, 4.0) * block_m]));
}

#[test]
fn files_that_are_no_maps_and_maps_of_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.itm");
    write(&path, &Vec::new(), &Vec::new(), &Vec::new());
    let map = SavedMap::open(&path, 0, &mut |_, _| ()).unwrap();
    assert_eq!((map.blocks(), map.bounds(), map.trajectory().len()), (0, None, 1));
    std::fs::write(&path, "not a map").unwrap();
    let error = SavedMap::open(&path, 0, &mut |_, _| ()).unwrap_err();
    assert!(matches!(error, itm_slam::Error::Io(itm_io::Error::NotAMap { .. })), "{error}");
}

#[test]
fn views_are_those_of_the_whole_map_and_of_the_true_sphere() {
    let Some(device) = device() else { return };
    let (centre, radius) = (Vec3::new(3.0, -2.25, 5.5), 44.0);
    let blocks = sphere(0, centre, radius);
    let mut map = open(&blocks, 64 << 10);
    let centre_m = (centre * VOXEL_M).as_dvec3();
    // All of the sphere, and then a part from nearby, back again, and sideways.
    let poses = [
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        [0.1, 0.05, -0.5, 0.1, -0.1, 0.3],
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        [-1.0, 0.1, 0.0, 0.0, 1.5, 0.0],
    ];
    let (few, many) = (50, 100_000);
    let mut views = [few, many].map(|bound| MapViews::new(&device, map.layout(), 0, bound).unwrap());
    for twist in poses {
        let pose = Se3::exp(twist);
        let pictures = views.each_mut().map(|views| {
            views.look(&mut map, &camera(), &pose, 3.0).unwrap();
            let shadings = [Shading::Grey, Shading::Normals, Shading::Colour, Shading::Depth, Shading::Confidence];
            let pictures = shadings.map(|shading| views.picture(shading, &Scale::default()).unwrap());
            (pictures, views.depth_millimetres().unwrap(), views.points().unwrap())
        });
        let mut of_all = MapViews::new(&device, map.layout(), 0, many).unwrap();
        // A view of everything first, so that all blocks are there for the second.
        of_all.look(&mut map, &camera(), &Se3::exp([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]), 9.0).unwrap();
        assert_eq!(of_all.blocks(), blocks.len());
        of_all.look(&mut map, &camera(), &pose, 3.0).unwrap();
        let [a, b] = &pictures;
        assert!(a == b && a.1 == of_all.depth_millimetres().unwrap() && a.2 == of_all.points().unwrap());

        let (_, depth, points) = a;
        assert!(points.positions.len() > 1000, "{} pixels of {twist:?}", points.positions.len());
        assert!(points.confidences.iter().all(|c| *c == 2.5) && points.weights.iter().all(|w| *w == 7.0));
        // The outline aside, where distances of front and back are mixed.
        let (mut off, mut turned) = (Vec::new(), Vec::new());
        for (p, n) in points.positions.iter().zip(&points.normals) {
            let out = p.as_dvec3() - centre_m;
            off.push((out.length() / f64::from(VOXEL_M) - f64::from(radius)).abs());
            turned.push(n.as_dvec3().angle_between(out).to_degrees());
        }
        let of_nine_in_ten = |values: &mut Vec<f64>| {
            values.sort_unstable_by(f64::total_cmp);
            values[values.len() * 9 / 10]
        };
        let (off, turned) = (of_nine_in_ten(&mut off), of_nine_in_ten(&mut turned));
        assert!(off < 0.15 && turned < 20.0, "{off} voxels and {turned} degrees of {twist:?}");
        let direction = pose.inverse().transform_point(centre_m);
        for (x, y) in [(79, 59), (60, 70), (90, 50)] {
            let ray = camera().unproject(DVec2::new(x.into(), y.into()), 1.0);
            let (a, b) = (ray.length_squared(), ray.dot(direction));
            let root = b * b - a * (direction.length_squared() - f64::from(radius * VOXEL_M).powi(2));
            if root < 0.0 {
                continue;
            }
            let truth = 1e3 * (b - root.sqrt()) / a;
            let found = f64::from(depth[(x, y)]);
            assert!((found - truth).abs() < 1.5, "{found} mm for {truth} at {x}, {y} of {twist:?}");
        }
    }
    assert!(views[0].blocks() < views[1].blocks());
}
