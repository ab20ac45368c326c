use std::fs;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3, IVec3};
use itm_core::voxel::{BlockKey, DistanceKind};
use itm_core::{DepthConversion, Distortion, Intrinsics, Se3, StampedPose, Timestamp, Trajectory};
use proptest::prelude::*;

use super::*;
use crate::whole_file::part_of;

/// A block and its key, or an unused index.
type Record = Option<(BlockKey, Vec<u32>)>;

fn header(voxel_kind: VoxelKind) -> MapHeader {
    let camera = Intrinsics::new(641, 479, 525.1, -525.2, 0.1 + 0.2, 1.0 / 3.0);
    let calibration = Calibration {
        depth_distortion: Distortion::brown([0.1, 0.0, 1e-7, 0.0, 0.0]),
        ..Calibration::registered(camera, DepthConversion::TUM)
    };
    let mut header = MapHeader::new(&Settings::default(), calibration, voxel_kind);
    header.counts = MapCounts { frames: 7, device_blocks: 2, host_blocks: 1 };
    header.extra.insert("note".into(), "a room".into());
    header
}

fn trajectory() -> Trajectory {
    let pose = |i: i64| {
        let rotation = DQuat::from_rotation_y(i as f64 * 0.1) * (1.0 + 1e-12);
        let translation = DVec3::new(i as f64 / 3.0, -0.0, 1e-300);
        StampedPose { timestamp: Timestamp(i * 33_333_333), world_from_camera: Se3 { rotation, translation } }
    };
    (-3..40).map(pose).collect()
}

fn submaps() -> Vec<SubmapPose> {
    let pose = |i: u16| SubmapPose {
        submap: 7 * i,
        world_from_submap: trajectory().poses()[usize::from(i)].world_from_camera,
        state: [SubmapState::Passive, SubmapState::Active, SubmapState::Primary][usize::from(i)],
    };
    (0..3).map(pose).collect()
}

/// Blocks of words from few values with noise, in part.
fn records(kind: VoxelKind, number: i32) -> Vec<Record> {
    let words = kind.block_words() as u32;
    let record = |i: i32| {
        let key = BlockKey { submap: 3, position: IVec3::new(i, -i, 32767) };
        let word = |w: u32| if i % 2 == 0 { w / 64 } else { (w * 7919 + i as u32).wrapping_mul(2_654_435_761) };
        (i % 5 != 2).then(|| (key, (0..words).map(word).collect()))
    };
    (0..number).map(record).collect()
}

fn write_blocks(writer: &mut MapWriter, tag: Tag, records: &[Record]) {
    let written = writer.blocks(tag, |sink| {
        records.iter().try_for_each(|record| match record {
            Some((key, words)) => sink.block(*key, words),
            None => sink.unused(),
        })
    });
    written.unwrap_or_else(|e: Error| panic!("{e}"));
}

fn read_blocks(reader: &mut MapReader, tag: Tag) -> Result<Vec<Record>, Error> {
    let mut records = Vec::new();
    let count = reader.blocks::<Error>(tag, |key, words| {
        assert!(key.is_some() || words.is_empty());
        records.push(key.map(|key| (key, words.to_vec())));
        Ok(())
    })?;
    assert_eq!(count, records.len() as u64);
    Ok(records)
}

/// A map of a few blocks, every kind of section among its sections.
fn write_map(path: &Path, kind: VoxelKind) {
    let mut writer = MapWriter::create(path, &header(kind)).unwrap();
    write_blocks(&mut writer, tag::BLOCKS, &records(kind, 4));
    write_blocks(&mut writer, tag::HOST_BLOCKS, &records(kind, 1));
    writer.trajectory(&trajectory()).unwrap();
    writer.submaps(&submaps()).unwrap();
    writer.bytes(*b"none", &[]).unwrap();
    writer.bytes(*b"mine", b"state").unwrap();
    writer.finish().unwrap();
}

/// All that is in a file.
#[derive(Debug, PartialEq)]
struct Content(MapHeader, Vec<Record>, Vec<Record>, Trajectory, Vec<SubmapPose>, Vec<u8>, Vec<u8>);

fn read_map(path: &Path) -> Result<Content, Error> {
    let mut reader = MapReader::open(path)?;
    let header = reader.header().clone();
    let blocks = read_blocks(&mut reader, tag::BLOCKS)?;
    let host = read_blocks(&mut reader, tag::HOST_BLOCKS)?;
    let trajectory = reader.trajectory()?;
    let (none, mine) = (reader.bytes(*b"none")?, reader.bytes(*b"mine")?);
    let submaps = reader.submaps()?;
    // Whoever reads all of it has checked all of it.
    reader.verify().unwrap_or_else(|e| panic!("{e}"));
    Ok(Content(header, blocks, host, trajectory, submaps, none, mine))
}

fn in_folder(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("room.itm")
}

#[test]
fn what_is_written_reads_back_and_again_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, again) = (in_folder(&folder), folder.path().join("again.itm"));
    for distance in [DistanceKind::I16, DistanceKind::F32] {
        for (colour, confidence) in [(false, false), (true, false), (true, true)] {
            let kind = VoxelKind { distance, colour, confidence };
            write_map(&path, kind);
            let (blocks, host) = (records(kind, 4), records(kind, 1));
            let content = Content(header(kind), blocks, host, trajectory(), submaps(), Vec::new(), b"state".to_vec());
            assert_eq!(read_map(&path).unwrap(), content);
            write_map(&again, kind);
            assert_eq!(fs::read(&path).unwrap(), fs::read(&again).unwrap());
        }
    }
    let mut reader = MapReader::open(&path).unwrap();
    assert!(reader.has(*b"mine") && !reader.has(*b"SURF"));
    assert_eq!(Settings::resolve(Some(("s", &reader.header().settings)), &[]), Ok(Settings::default()));
    assert_eq!(reader.sections().last().unwrap(), SectionInfo { tag: *b"mine", raw_bytes: 5, stored_bytes: 17 });
    let error = reader.bytes(*b"SURF").unwrap_err().to_string();
    assert!(error.contains("room.itm' has no section SURF"), "{error}");
}

#[test]
fn sections_of_many_chunks_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let kind = VoxelKind { colour: true, ..VoxelKind::default() };
    let blocks = records(kind, 1500);
    let bytes: Vec<u8> = (0..3 * CHUNK_BYTES).map(|i| (i >> 8) as u8).collect();
    let mut writer = MapWriter::create(&path, &header(kind)).unwrap();
    writer.bytes(*b"long", &bytes).unwrap();
    write_blocks(&mut writer, tag::BLOCKS, &blocks);
    writer.finish().unwrap();
    let mut reader = MapReader::open(&path).unwrap();
    let stored: Vec<_> = reader.sections().map(|s| s.stored_bytes).collect();
    assert!(stored[1] < 100_000 && stored[2] > 2_000_000, "{stored:?}");
    assert_eq!(reader.bytes(*b"long").unwrap(), bytes);
    assert!(read_blocks(&mut reader, tag::BLOCKS).unwrap() == blocks);
    // Whoever consumes may stop.
    let stopped = reader.blocks(tag::BLOCKS, |_, _| Err(Error::NotFound { path: "here".into() }));
    assert!(matches!(stopped, Err(Error::NotFound { .. })));
    reader.verify().unwrap();
}

#[test]
fn a_file_cut_off_anywhere_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    write_map(&path, VoxelKind::default());
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).filter(|i| i % 29 == 0 || *i < 200 || *i > whole.len() - 200) {
        fs::write(&path, &whole[..length]).unwrap();
        match MapReader::open(&path).unwrap_err() {
            Error::MapCutOff { length: said, .. } => assert_eq!(said, length as u64),
            Error::NotAMap { .. } if length == 0 => {}
            other => panic!("{length}: {other}"),
        }
    }
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let error = MapReader::open(&path).unwrap_err().to_string();
    assert!(error.ends_with(&format!("it ends after {} bytes, within section BLKS", whole.len() / 2)), "{error}");
    let mut longer = whole;
    longer.push(0);
    fs::write(&path, &longer).unwrap();
    assert!(matches!(MapReader::open(&path), Err(Error::MapDamaged { .. })));
}

#[test]
fn a_flipped_bit_anywhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    write_map(&path, VoxelKind::default());
    let mut bytes = fs::read(&path).unwrap();
    let headers = fs::read(&path).unwrap().len() - 400;
    for at in (0..bytes.len()).filter(|i| i % 23 == 0 || *i < 200 || *i > headers) {
        let bit = 1 << (at % 8);
        bytes[at] ^= bit;
        fs::write(&path, &bytes).unwrap();
        assert!(read_map(&path).is_err(), "byte {at}");
        bytes[at] ^= bit;
    }
    bytes[3000] ^= 1;
    fs::write(&path, &bytes).unwrap();
    let error = MapReader::open(&path).unwrap().verify().unwrap_err().to_string();
    assert!(error.contains("is damaged in section BLKS: its checksum is wrong"), "{error}");
}

proptest! {
    /// Lies with the right checksums, as a faulty program might write them.
    #[test]
    fn no_lengths_are_believed(
        tag in prop::sample::select(vec![tag::HEADER, tag::BLOCKS, tag::TRAJECTORY]),
        raw_length: u32, stored_length: u32, small in 0..40u32,
        raw_bytes in prop_oneof![Just(u64::MAX), any::<u64>(), 0..100u64],
        stored_bytes in prop_oneof![3 => Just(None), 1 => any::<u64>().prop_map(Some)],
        payload in prop::collection::vec(any::<u8>(), 0..60),
        honest: bool,
    ) {
        let lengths = if honest { [small, payload.len() as u32] } else { [raw_length, stored_length] };
        let lengths = lengths.map(u32::to_le_bytes);
        let checksum = checksum_over(checksum_seed(tag), &[lengths.as_flattened(), &payload]);
        let stored_bytes = stored_bytes.unwrap_or((CHUNK_HEADER_BYTES + payload.len()) as u64);
        let lie = SectionHeader { tag, sections: 0, raw_bytes, stored_bytes, checksum }.encode();

        // In place of a good header, or behind one.
        let folder = tempfile::tempdir().unwrap();
        let path = in_folder(&folder);
        MapWriter::create(&path, &header(VoxelKind::default())).unwrap().finish().unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let before = if tag == tag::HEADER { PREFIX_BYTES } else { bytes.len() - SECTION_HEADER_BYTES };
        bytes.truncate(before);
        let good = bytes[PREFIX_BYTES..].first_chunk::<SECTION_HEADER_BYTES>().copied();
        let checksums = checksum_over(0, &[good.as_ref().map_or(&[], |h| &h[..]), &lie]);
        bytes.extend(lie);
        bytes.extend_from_slice(lengths.as_flattened());
        bytes.extend(checksum.to_le_bytes());
        bytes.extend(payload);
        bytes.extend(SectionHeader::end(1 + u32::from(good.is_some()), checksums).encode());
        fs::write(&path, &bytes).unwrap();

        let read = || {
            let mut reader = MapReader::open(&path)?;
            if tag == tag::BLOCKS { read_blocks(&mut reader, tag).map(drop) } else { reader.trajectory().map(drop) }
        };
        match read().unwrap_err() {
            Error::MapDamaged { place, .. } => prop_assert_eq!(place, name_of(tag)),
            Error::MapCutOff { within, .. } => prop_assert_eq!(within, name_of(tag)),
            Error::MapContent { place, .. } => prop_assert_eq!(place, name_of(tag)),
            other => prop_assert!(false, "{}", other),
        }
    }
}

#[test]
fn other_files_and_later_versions_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let refused = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        MapReader::open(&path).unwrap_err().to_string()
    };
    for bytes in [&b"ply\nformat"[..], b"\x89PNG\r\n\x1a\n and so on, for long", b""] {
        assert!(refused(bytes).ends_with("room.itm' is not a map file of itm"));
    }
    let error = refused(&writer::prefix((2, 5)));
    assert!(error.contains("of format 2.5; this program reads up to 1.0"), "{error}");
    assert!(refused(&writer::prefix((0, 5))).contains("is damaged"));
    // A later minor version is read.
    write_map(&path, VoxelKind::default());
    let content = read_map(&path).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    bytes[..PREFIX_BYTES].copy_from_slice(&writer::prefix((1, 9)));
    fs::write(&path, &bytes).unwrap();
    assert_eq!(read_map(&path).unwrap(), content);
    let missing = MapReader::open(&folder.path().join("none.itm")).unwrap_err().to_string();
    assert!(missing.contains("cannot open") && missing.contains("none.itm"), "{missing}");
}

#[test]
fn content_that_cannot_be_meant_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let kind = VoxelKind::default();
    let mut wrong = header(kind);
    wrong.voxel_size_m = f32::NAN;
    let error = MapWriter::create(&path, &wrong).unwrap_err().to_string();
    assert!(error.contains("section HEAD: expected voxel_size_m to be positive and finite, found NaN"), "{error}");
    let mut wrong = header(kind);
    wrong.calibration.depth.width = 0;
    assert!(MapWriter::create(&path, &wrong).unwrap_err().to_string().contains("depth camera's image size"));

    // Sections that claim to be what they are not.
    let mut writer = MapWriter::create(&path, &header(kind)).unwrap();
    writer.bytes(tag::BLOCKS, &[0; 2 * (8 + 2048) + 9]).unwrap();
    writer.bytes(tag::TRAJECTORY, &[0; 64]).unwrap();
    writer.finish().unwrap();
    let mut reader = MapReader::open(&path).unwrap();
    let error = read_blocks(&mut reader, tag::BLOCKS).unwrap_err().to_string();
    assert!(error.ends_with("section BLKS: expected blocks of 2048 bytes, found 9 bytes behind block 2"), "{error}");
    let error = reader.trajectory().unwrap_err().to_string();
    assert!(error.contains("section TRAJ") && error.contains("pose 0"), "{error}");
}

#[test]
fn a_writer_that_fails_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let kind = VoxelKind::default();
    write_map(&path, kind);
    let old = fs::read(&path).unwrap();
    let whole = || fs::read(&path).unwrap() == old && fs::read_dir(folder.path()).unwrap().count() == 1;

    let mut writer = MapWriter::create(&path, &header(kind)).unwrap();
    write_blocks(&mut writer, tag::BLOCKS, &records(kind, 2000));
    drop(writer);
    assert!(whole(), "dropped midway");

    let mut writer = MapWriter::create(&path, &header(kind)).unwrap();
    let error = writer.blocks::<Error>(tag::BLOCKS, |sink| {
        sink.unused()?;
        sink.block(BlockKey::unpack([1, 2]), &[0; 1024])
    });
    let error = error.unwrap_err().to_string();
    assert!(error.contains("expected blocks of 512 words, as of the voxel kind, found one of 1024"), "{error}");
    assert!(whole(), "nothing waits for the writer to go");
    assert!(writer.bytes(*b"more", b"more").unwrap_err().to_string().contains("an earlier section"));
    assert!(writer.finish().unwrap_err().to_string().contains("an earlier section"));
    assert!(whole(), "its producer failed");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let kind = VoxelKind::default();
    write_map(&path, kind);
    let old = fs::read(&path).unwrap();
    // In the middle, and where all of it waits in the buffer until the end.
    for blocks in [2000, 1] {
        std::os::unix::fs::symlink("/dev/full", part_of(&path)).unwrap();
        let write = || {
            let mut writer = MapWriter::create(&path, &header(kind))?;
            writer.blocks(tag::BLOCKS, |sink| {
                let mut records = records(kind, blocks).into_iter().flatten();
                records.try_for_each(|(key, words)| sink.block(key, &words))
            })?;
            writer.finish()
        };
        let error = write().unwrap_err();
        assert!(
            matches!(&error, Error::Io { reason, .. } if reason.kind() == std::io::ErrorKind::StorageFull),
            "{error}"
        );
        assert!(error.to_string().contains("cannot write") && error.to_string().contains("room.itm"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), old);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

#[test]
fn submaps_that_cannot_be_meant_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = in_folder(&folder);
    let create = || MapWriter::create(&path, &header(VoxelKind::default())).unwrap();
    let read = |bytes: &[u8]| {
        let mut writer = create();
        writer.bytes(tag::SUBMAPS, bytes).unwrap();
        writer.finish().unwrap();
        MapReader::open(&path).unwrap().submaps()
    };
    let refused = |submaps: Vec<SubmapPose>, words: &str| {
        let written = create().submaps(&submaps).unwrap_err().to_string();
        let found = read(&submaps.iter().flat_map(submaps::encode).collect::<Vec<_>>()).unwrap_err();
        assert!(matches!(found, Error::MapContent { .. }), "{found}");
        for error in [written, found.to_string()] {
            assert!(error.contains("section SUBM") && error.contains(words), "{error}");
        }
    };
    let mut twice = submaps();
    twice[2].submap = 7;
    refused(twice, "two of submap 7");
    let mut endless = submaps();
    endless[1].world_from_submap.translation.y = f64::NAN;
    refused(endless, "submap 7 is none");
    let mut stretched = submaps();
    stretched[2].world_from_submap.rotation *= 1.1;
    refused(stretched, "submap 14 is none");

    let whole: Vec<u8> = submaps().iter().flat_map(submaps::encode).collect();
    assert_eq!(read(&whole).unwrap(), submaps());
    assert!(read(&whole[..100]).unwrap_err().to_string().contains("poses of 64 bytes, found 100 bytes"));
    let with = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        read(&bytes).unwrap_err().to_string()
    };
    assert!(with(2, 1).contains("number 65536"));
    assert!(with(64 + 4, 3).contains("state 3 of submap 7"));

    create().finish().unwrap();
    assert_eq!(MapReader::open(&path).unwrap().submaps().unwrap(), []);
}
