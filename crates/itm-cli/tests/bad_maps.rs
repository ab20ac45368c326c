//! Maps of submaps whose files hold what no session can use: what the program says, and what it keeps.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use itm_core::voxel::BlockKey;
use itm_io::map_file::{MapReader, MapWriter, SubmapState, Tag, tag};
use itm_synth::{DepthNoise, Sequence, Spec};
use serde_json::Value as Json;
use tempfile::TempDir;
use toml::{Table, Value};

const ATLAS: Tag = *b"ATLS";
const STATE: Tag = *b"STAT";
const KEYFRAMES: Tag = *b"KEYF";
/// The recording's frames, and those of them that the saved session has seen.
const FRAMES: u32 = 48;
const SAVED: usize = 45;

/// A folder with a recording, `room`, and a session of several submaps saved from its beginning, `room.itm`; `None` where
/// there is no device to run on.
fn folder() -> Option<&'static Path> {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        return None;
    }
    let make = || {
        let folder = tempfile::tempdir().unwrap();
        let spec = Spec::new(itm_synth::Path::Loop).with_size(160, 120).with_noise(DepthNoise::KINECT, 5);
        // Half of the way round, so that it comes to several submaps in few frames.
        let spec = Spec { duration_s: 3.0, ..spec.with_frames(FRAMES) };
        itm_synth::write_recording(&folder.path().join("room"), &Sequence::new(spec).unwrap(), &|_| ()).unwrap();
        let frames = format!("0..{SAVED}");
        let settings =
            ["map.voxel_size_m=0.02", "map.truncation_m=0.08", "submaps.new_below=0.5", "submaps.link_frames=5"];
        let settings = settings.iter().flat_map(|setting| ["--set", setting]);
        let more = ["--mode", "loop-closure", "--frames", &frames, "--save", "room.itm", "--json"];
        let output = run(folder.path(), settings.chain(more));
        assert!(output.succeeded, "{}", output.said);
        let submaps = reader(folder.path(), "room.itm").submaps().unwrap();
        assert!(submaps.len() >= 3, "{submaps:?}");
        folder
    };
    Some(FOLDER.get_or_init(make).path())
}

/// What the program said.
struct Said {
    succeeded: bool,
    said: String,
    summary: Json,
}

impl Said {
    #[track_caller]
    fn has(&self, words: &[&str]) {
        words.iter().for_each(|word| assert!(self.said.contains(word), "'{word}' is not in: {}", self.said));
    }

    /// It ran to its end and said this, in its summary too.
    #[track_caller]
    fn warned(&self, words: &[&str]) {
        assert!(self.succeeded, "{}", self.said);
        self.has(words);
        let messages: Vec<&str> =
            self.summary["messages"].as_array().unwrap().iter().map(|m| m["text"].as_str().unwrap()).collect();
        let told = |message: &&str| words.iter().all(|word| message.contains(word));
        assert!(messages.iter().any(told), "{words:?} are not in {messages:#?}");
    }

    #[track_caller]
    fn refused(&self, words: &[&str]) {
        assert!(!self.succeeded && !self.said.contains("panicked"), "{}", self.said);
        self.has(words);
    }
}

/// Runs the program on the recording, without a mesh.
fn run<'a>(folder: &Path, more: impl IntoIterator<Item = &'a str>) -> Said {
    said(folder, ["run", "room", "--no-mesh", "--quiet"].into_iter().chain(more))
}

fn said<'a>(folder: &Path, arguments: impl IntoIterator<Item = &'a str>) -> Said {
    let command = Command::new(env!("CARGO_BIN_EXE_itm")).args(arguments).current_dir(folder).output();
    let Output { status, stdout, stderr } = command.unwrap();
    let said = String::from_utf8(stderr).unwrap();
    Said { succeeded: status.success(), said, summary: serde_json::from_slice(&stdout).unwrap_or_default() }
}

fn reader(folder: &Path, name: &str) -> MapReader {
    MapReader::open(&folder.join(name)).unwrap()
}

fn table(folder: &Path, name: &str, section: Tag) -> Table {
    String::from_utf8(reader(folder, name).bytes(section).unwrap()).unwrap().parse().unwrap()
}

/// Writes `room.itm` anew under another name, its sections as they are left by `edit`; none where it says so.
fn edited(folder: &Path, name: &str, edit: impl Fn(Tag, Vec<u8>) -> Option<Vec<u8>>) -> PathBuf {
    edited_from(folder, "room.itm", name, edit)
}

/// The same with another map.
fn edited_from(folder: &Path, map: &str, name: &str, edit: impl Fn(Tag, Vec<u8>) -> Option<Vec<u8>>) -> PathBuf {
    let mut reader = reader(folder, map);
    let path = folder.join(name);
    let mut writer = MapWriter::create(&path, &reader.header().clone()).unwrap();
    let tags: Vec<Tag> = reader.sections().map(|section| section.tag).filter(|tag| *tag != tag::HEADER).collect();
    for tag in tags {
        if let Some(bytes) = edit(tag, reader.bytes(tag).unwrap()) {
            writer.bytes(tag, &bytes).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

/// The same with one section of TOML changed.
fn with_toml(folder: &Path, name: &str, section: Tag, edit: impl Fn(&mut Table)) {
    edited(folder, name, |tag, bytes| {
        if tag != section {
            return Some(bytes);
        }
        let mut table: Table = String::from_utf8(bytes).unwrap().parse().unwrap();
        edit(&mut table);
        Some(table.to_string().into_bytes())
    });
}

/// The same with some submap's blocks left away.
fn without_blocks(folder: &Path, name: &str, gone: impl Fn(BlockKey) -> bool) {
    let mut reader = reader(folder, "room.itm");
    let mut writer = MapWriter::create(&folder.join(name), &reader.header().clone()).unwrap();
    let tags: Vec<Tag> = reader.sections().map(|section| section.tag).filter(|tag| *tag != tag::HEADER).collect();
    for tag in tags {
        if tag != tag::BLOCKS {
            writer.bytes(tag, &reader.bytes(tag).unwrap()).unwrap();
            continue;
        }
        writer
            .blocks::<itm_io::Error>(tag, |sink| {
                reader.blocks(tag, |key, words| match key {
                    Some(key) if !gone(key) => sink.block(key, words),
                    _ => sink.unused(),
                })?;
                Ok(())
            })
            .unwrap();
    }
    writer.finish().unwrap();
}

fn list<'a>(table: &'a mut Table, key: &str) -> &'a mut Vec<Value> {
    table[key].as_array_mut().unwrap()
}

/// The ends of the links in a file.
fn links(folder: &Path, name: &str) -> Vec<(i64, i64)> {
    let table = table(folder, name, ATLAS);
    let end = |link: &Value, key: &str| link[key].as_integer().unwrap();
    table["links"].as_array().unwrap().iter().map(|link| (end(link, "from"), end(link, "to"))).collect()
}

/// Arguments of a run of a few frames that starts in a map, in the middle of its first submap.
fn in_map(map: &str) -> [&str; 8] {
    ["--map", map, "--start-pose", "0,0,0,0,0,0,1", "--frames", "0..3", "--json", "-o"]
}

#[test]
fn keyframes_of_other_ferns_are_left_out_and_all_else_stays() {
    let Some(folder) = folder() else { return };
    let other = ["--set", "relocaliser.ferns=400", "--set", "relocaliser.seed=3"];
    let differences = "relocaliser.ferns = 1000 (here 400), relocaliser.seed = 1 (here 3)";
    // Without a pose nothing could find the camera.
    let refused = run(folder, ["--map", "room.itm", "--frames", "0..3", "-o", "ferns"].into_iter().chain(other));
    refused.refused(&["room.itm", differences, "--start-pose"]);
    let before = fs::read(folder.join("room.itm")).unwrap();

    let more = ["ferns", "--save", "ferns.itm"].into_iter().chain(other);
    let ran = run(folder, in_map("room.itm").into_iter().chain(more));
    ran.warned(&["'room.itm', section KEYF: the keyframes are left out", differences, "a lost camera"]);
    assert_eq!(ran.summary["posed"], 3);
    assert!(fs::read(folder.join("room.itm")).unwrap() == before);
    let (was, is) = (reader(folder, "room.itm").submaps().unwrap(), reader(folder, "ferns.itm").submaps().unwrap());
    assert_eq!(was.len(), is.len());
    assert_eq!(links(folder, "room.itm"), links(folder, "ferns.itm"));
    let blocks = |name: &str| {
        let mut keys = Vec::new();
        for tag in [tag::BLOCKS, tag::HOST_BLOCKS].into_iter().filter(|tag| reader(folder, name).has(*tag)) {
            let keep = |key: Option<BlockKey>, _: &[u32]| {
                keys.extend(key.map(BlockKey::pack));
                Ok::<(), itm_io::Error>(())
            };
            reader(folder, name).blocks(tag, keep).unwrap();
        }
        keys
    };
    let (was, is) = (blocks("room.itm"), blocks("ferns.itm"));
    assert!(was.len() > 500 && was.iter().all(|key| is.contains(key)), "{} blocks, then {}", was.len(), is.len());

    // Bytes that are no keyframes, in the session that goes on too.
    edited(folder, "keyframes.itm", |tag, bytes| Some(if tag == KEYFRAMES { bytes[..40].to_vec() } else { bytes }));
    let what = ["section KEYF: the keyframes are left out", "cannot be read"];
    run(folder, in_map("keyframes.itm").into_iter().chain(["keyframes"])).warned(&what);
    let ran = run(folder, ["--resume", "keyframes.itm", "--json", "-o", "keyframes"]);
    ran.warned(&what);
    assert_eq!(ran.summary["posed"], u64::from(FRAMES) - SAVED as u64);
    run(folder, ["--map", "keyframes.itm", "--frames", "0..3", "-o", "keyframes"]).refused(&[
        "keyframes.itm",
        "cannot be read",
        "--start-pose",
    ]);
}

/// Sets an entry of a pose.
fn set_x(pose: &mut Value, metres: f64) {
    pose["translation"][0] = metres.into();
}

#[test]
fn links_that_cannot_be_are_left_out_and_others_stay() {
    let Some(folder) = folder() else { return };
    let before = links(folder, "room.itm");
    assert!(before.len() >= 2, "{before:?}");
    // One that was measured.
    let measured = table(folder, "room.itm", ATLAS)["links"].as_array().unwrap().clone();
    let at = measured.iter().position(|link| link.get("found").is_some()).unwrap();
    let first = before[at];
    type Edit = fn(&mut Value);
    let edits: [(&str, Edit, &str); 6] = [
        ("unknown", |link| link["to"] = 77.into(), "there is no submap 77"),
        ("itself", |link| link["to"] = link["from"].clone(), "itself"),
        ("nan", |link| set_x(&mut link["found"][0], f64::NAN), "finite"),
        ("infinite", |link| link["information"][2][2] = f64::INFINITY.into(), "finite numbers"),
        ("indefinite", |link| link["information"][2][2] = (-1e9).into(), "positive semidefinite"),
        ("observation", |link| set_x(&mut link["observations"][0]["from_from_to"], f64::NAN), "a frame's measurement"),
    ];
    for (name, edit, reason) in edits {
        let map = format!("{name}.itm");
        with_toml(folder, &map, ATLAS, |atlas| edit(&mut list(atlas, "links")[at]));
        let (from, to) = match name {
            "unknown" => (first.0, 77),
            "itself" => (first.0, first.0),
            _ => first,
        };
        let link = format!("'{map}', section ATLS: the link from submap {from} to submap {to} is left out");
        let ran = run(folder, ["--resume", &map, "--json", "-o", name, "--save", "after.itm"]);
        ran.warned(&[&link, reason]);
        assert_eq!(ran.summary["posed"], u64::from(FRAMES) - SAVED as u64, "{name}");
        let after = links(folder, "after.itm");
        let others = before.iter().enumerate().filter(|(i, _)| *i != at);
        assert!(others.map(|(_, link)| link).all(|link| after.contains(link)), "{name}: {after:?}");
        assert!(!ran.said.contains("cannot be optimised"), "{}", ran.said);
    }
    // In a new session too.
    let ran = run(folder, in_map("nan.itm").into_iter().chain(["nan"]));
    ran.warned(&["section ATLS: the link from submap", "left out"]);
    // One that is there twice counts once.
    with_toml(folder, "twice.itm", ATLAS, |atlas| {
        let again = list(atlas, "links")[0].clone();
        list(atlas, "links").push(again);
    });
    run(folder, ["--resume", "twice.itm", "--json", "-o", "twice"]).warned(&["left out: there is another one"]);
}

#[test]
fn what_else_is_wrong_with_submaps_is_left_out_or_refused_by_section() {
    let Some(folder) = folder() else { return };
    let resumed = |name: &str| run(folder, ["--resume", name, "--json", "-o", "resumed", "--save", "resumed.itm"]);
    let primary = table(folder, "room.itm", STATE)["primary"]["submap"].as_integer().unwrap();
    let submaps = reader(folder, "room.itm").submaps().unwrap().len();

    // A second primary: the session knows which one it is.
    with_toml(folder, "primaries.itm", ATLAS, |atlas| {
        list(atlas, "submaps").iter_mut().for_each(|submap| submap["state"] = "primary".into());
    });
    let other = (primary + 1) % submaps as i64;
    let words = [format!("that submap {other} is primary is left out"), format!("submap {primary} as primary")];
    resumed("primaries.itm").warned(&[&words[0], &words[1]]);
    let states = reader(folder, "resumed.itm").submaps().unwrap();
    assert_eq!(states.iter().filter(|submap| submap.state == SubmapState::Primary).count(), 1);

    // Frames in a submap that is not there, or without a pose.
    with_toml(folder, "frames.itm", ATLAS, |atlas| {
        list(atlas, "frames")[3][1] = 77.into();
        set_x(&mut list(atlas, "frames")[5][2], f64::NAN);
    });
    let ran = resumed("frames.itm");
    ran.warned(&["1 frames of the trajectory are left out: they are in submaps that are not there"]);
    ran.warned(&["1 frames of the trajectory are left out: their poses are none"]);
    assert_eq!(reader(folder, "resumed.itm").trajectory().unwrap().len(), FRAMES as usize - 2);

    // Where a submap began, and an optimisation's result that was to be taken over.
    with_toml(folder, "born.itm", ATLAS, |atlas| list(atlas, "submaps")[1]["parent"][0] = 1.into());
    resumed("born.itm").warned(&["where submap 1 began is left out: submap 1 is no earlier one"]);
    with_toml(folder, "result.itm", ATLAS, |atlas| {
        let pose: Value = list(atlas, "submaps")[1]["world_from_submap"].clone();
        let mut poses = vec![pose; submaps];
        set_x(&mut poses[0], f64::INFINITY);
        let done = "submaps = 3\nlinks = 2\nmoved_m = 0.0\ncost = [0.0, 0.0]\ndoubted = 0".parse::<Table>().unwrap();
        let result = Value::Array(vec![poses.into(), done.into()]);
        atlas.insert("running".into(), Value::Array(vec![(SAVED as i64 + 1).into(), result]));
    });
    resumed("result.itm").warned(&["the last optimisation's result is left out", "finite", "another one begins"]);

    // Tracking in a submap that is not there.
    with_toml(folder, "beside.itm", STATE, |state| {
        list(state, "beside")[0][0]["submap"] = 77.into();
    });
    resumed("beside.itm").warned(&["section STAT: tracking in submap 77 is left out: it is not there"]);

    // Keyframes of a submap that is not there.
    edited(folder, "strange.itm", |tag, mut bytes| {
        if tag == KEYFRAMES {
            let settings = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
            let submap = 16 + settings + 12 + 4;
            bytes[submap..submap + 2].copy_from_slice(&77_u16.to_le_bytes());
            let end = bytes.len() - 4;
            let checksum = crc32fast::hash(&bytes[..end]);
            bytes[end..].copy_from_slice(&checksum.to_le_bytes());
        }
        Some(bytes)
    });
    let what = "section KEYF: 1 keyframes of submap 77 are left out: it is not there";
    resumed("strange.itm").warned(&[what]);
    run(folder, in_map("strange.itm").into_iter().chain(["strange"])).warned(&[what]);

    // What all else depends on is an error, and the file is as it was.
    type Edit = fn(&mut Table);
    let refusals: [(Tag, Edit, &str); 6] = [
        (ATLAS, |a| set_x(&mut list(a, "submaps")[1]["world_from_submap"], f64::NAN), "the pose of submap 1"),
        (ATLAS, |a| list(a, "submaps").clear(), "0 submaps"),
        (ATLAS, |a| list(a, "submaps").truncate(1), "submap"),
        (ATLAS, |a| drop(a.insert("way_m".into(), f64::NAN.into())), "NaN m"),
        (ATLAS, |a| drop(a.remove("links")), "links"),
        (STATE, |s| s["primary"]["submap"] = 77.into(), "frames are fused into submap 77, which is not there"),
    ];
    for (section, edit, reason) in refusals {
        with_toml(folder, "refused.itm", section, edit);
        let before = fs::read(folder.join("refused.itm")).unwrap();
        let section = section.escape_ascii().to_string();
        let sessions = if section == "ATLS" { 2 } else { 1 };
        let runs = [run(folder, ["--resume", "refused.itm", "-o", "refused"])]
            .into_iter()
            .chain((1..sessions).map(|_| run(folder, in_map("refused.itm").into_iter().chain(["refused"]))));
        for ran in runs {
            ran.refused(&["'refused.itm'", reason]);
        }
        assert!(fs::read(folder.join("refused.itm")).unwrap() == before);
    }
    // A map without a session's knowledge of its submaps is one to start in all the same.
    edited(folder, "bare.itm", |tag, bytes| (![ATLAS, STATE, KEYFRAMES].contains(&tag)).then_some(bytes));
    let ran = run(folder, in_map("bare.itm").into_iter().chain(["bare", "--fusion", "off"]));
    assert!(ran.succeeded && ran.summary["posed"] == 3, "{}", ran.said);
    assert_eq!(ran.summary["submaps"], submaps);
    run(folder, in_map("bare.itm").into_iter().chain(["bare", "--mode", "basic"])).refused(&[
        "bare.itm",
        &format!("submaps: {submaps}"),
        "mode = \"basic\"",
    ]);
}

#[test]
fn a_submap_without_blocks_is_left_out() {
    let Some(folder) = folder() else { return };
    let submaps = reader(folder, "room.itm").submaps().unwrap();
    let primary = submaps.iter().find(|submap| submap.state == SubmapState::Primary).unwrap().submap;
    let gone = submaps.iter().map(|submap| submap.submap).find(|submap| *submap != primary && *submap != 0).unwrap();
    without_blocks(folder, "hole.itm", |key| key.submap == gone);
    let what = format!("submap {gone} has no blocks and is left out, with its");
    let ran = run(folder, ["--resume", "hole.itm", "--json", "-o", "hole", "--save", "hole-after.itm"]);
    ran.warned(&[&what, "keyframes"]);
    assert_eq!(ran.summary["posed"], u64::from(FRAMES) - SAVED as u64);
    assert_eq!(links(folder, "room.itm"), links(folder, "hole-after.itm"), "what was measured stays");
    // Started where that submap was seen best, the camera is tracked in another one; found by keyframes too.
    let seen = reader(folder, "room.itm").trajectory().unwrap();
    let table = table(folder, "room.itm", ATLAS);
    let of_gone = |(_, frame): &(usize, &Value)| frame[1].as_integer() == Some(gone.into());
    let frames = table["frames"].as_array().unwrap();
    let (at, _) = frames.iter().enumerate().find(of_gone).unwrap();
    let pose = seen.poses()[at].world_from_camera;
    let (t, q) = (pose.translation, pose.rotation);
    let pose = format!("--start-pose={},{},{},{},{},{},{}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    let range = format!("{at}..{}", at + 3);
    for (start, posed) in [(Some(&*pose), 1..4), (None, 0..4)] {
        let ran =
            run(folder, ["--map", "hole.itm", "--frames", &range, "--json", "-o", "hole"].into_iter().chain(start));
        ran.warned(&[&what]);
        assert!(posed.contains(&ran.summary["posed"].as_u64().unwrap()), "{}", ran.said);
        let found = format!("of submap {gone}");
        assert!(
            !ran.summary["messages"].to_string().replace(&what, "").contains(&found),
            "{}",
            ran.summary["messages"]
        );
    }
    let seen = said(folder, ["mesh", "hole.itm", "-o", "hole.ply"]);
    assert!(seen.succeeded, "{}", seen.said);
    let seen = said(folder, ["render", "hole.itm", "-o", "views", "--every", "20"]);
    assert!(seen.succeeded, "{}", seen.said);
    let info = said(folder, ["info", "hole.itm", "--json"]);
    assert_eq!(info.summary["submaps"][usize::from(gone)]["blocks"], 0);

    // The one that frames are fused into: the camera is found in another, or lost, but nothing stops.
    without_blocks(folder, "primary.itm", |key| key.submap == primary);
    let what = format!("submap {primary} has no blocks and is left out");
    run(folder, ["--resume", "primary.itm", "--json", "-o", "hole"]).warned(&[&what]);
    // All of them.
    without_blocks(folder, "empty.itm", |_| true);
    run(folder, ["--resume", "empty.itm", "--json", "-o", "hole"]).warned(&["submap 0 has no blocks and is left out"]);
    run(folder, in_map("empty.itm").into_iter().chain(["hole"])).refused(&["the map 'empty.itm' is empty"]);
    // Blocks that belong nowhere.
    with_toml(folder, "nowhere.itm", ATLAS, |atlas| {
        list(atlas, "submaps").truncate(1);
        list(atlas, "links").clear();
    });
    run(folder, in_map("nowhere.itm").into_iter().chain(["hole"])).refused(&[
        "'nowhere.itm'",
        "there are blocks of submap 1",
        "nothing says where it lies",
    ]);
}

#[test]
fn surfels_that_cannot_be_are_refused_by_section_and_number() {
    let Some(folder) = folder() else { return };
    let saved = run(folder, ["--mode", "surfels", "--frames", "0..20", "--save", "surfels.itm", "-o", "surfels"]);
    assert!(saved.succeeded, "{}", saved.said);
    const SURFELS: Tag = *b"SURF";
    let bytes = reader(folder, "surfels.itm").bytes(SURFELS).unwrap();
    let confidence = |slot: usize| f32::from_le_bytes(bytes[slot * 32 + 12..][..4].try_into().unwrap());
    let slots = bytes.len() / 32;
    let known = (0..slots).filter(|slot| confidence(*slot) > 0.0).nth(100).unwrap();
    let word = |of: usize, word: usize, value: u32| {
        let mut bytes = bytes.clone();
        bytes[of * 32 + word * 4..][..4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    let cannot_be = format!("'damaged.itm': section SURF: surfel {known} has numbers that cannot be");
    let damages = [
        (word(known, 0, f32::NAN.to_bits()), &*cannot_be),
        (word(known, 2, f32::NEG_INFINITY.to_bits()), &cannot_be),
        (word(known, 3, (-1.0_f32).to_bits()), &cannot_be),
        (word(known, 3, f32::INFINITY.to_bits()), &cannot_be),
        (bytes[..bytes.len() - 12].to_vec(), "section SURF: "),
        (word(known, 5, 77 << 16), "of submap 77, but nothing says where it lies"),
    ];
    let frames = ["--frames", "0..24", "--mode", "surfels", "-o", "damaged"];
    for (surfels, what) in damages {
        edited_from(folder, "surfels.itm", "damaged.itm", |tag, bytes| {
            Some(if tag == SURFELS { surfels.clone() } else { bytes })
        });
        for way in ["--resume", "--map"] {
            run(folder, [way, "damaged.itm"].into_iter().chain(frames)).refused(&["'damaged.itm'", what]);
        }
    }
    // A free slot that holds a surfel, and one that comes twice: the session cannot go on, and a new one starts from the surfels alone.
    let emptied = word(known, 3, 0);
    let with_free = |slots: &[usize], surfels: &[u8]| {
        edited_from(folder, "surfels.itm", "free.itm", |tag, mut bytes| {
            match &tag {
                b"SFCN" => {
                    bytes[4..8].copy_from_slice(&(slots.len() as u32).to_le_bytes());
                    bytes[8..12].fill(0);
                }
                b"SFFR" => bytes = slots.iter().flat_map(|slot| (*slot as u32).to_le_bytes()).collect(),
                b"SURF" => bytes = surfels.to_vec(),
                _ => {}
            }
            Some(bytes)
        });
        run(folder, ["--resume", "free.itm"].into_iter().chain(frames))
    };
    let ran = with_free(&[known], &emptied);
    assert!(ran.succeeded, "{}", ran.said);
    for (slots, surfels) in [(&[known][..], &bytes), (&[known, known], &emptied), (&[slots], &bytes)] {
        with_free(slots, surfels).refused(&["the saved state of the map of surfels does not fit"]);
        let ran = run(folder, ["--map", "free.itm"].into_iter().chain(frames));
        assert!(ran.succeeded, "{}", ran.said);
    }
}
