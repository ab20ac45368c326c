//! Keyframes that are saved and loaded.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use common::{ferns, wall};
use itm_core::{RelocaliserImage, RelocaliserSettings, Se3, Settings, Timestamp};
use itm_reloc::{Difference, Error, Ferns, Harvest, Relocaliser as _};
use proptest::prelude::*;

fn settings() -> RelocaliserSettings {
    RelocaliserSettings { ferns: 70, min_dissimilarity: 0.05, ..Default::default() }
}

/// Some keyframes, the first and the last of which were removed.
fn filled() -> Ferns {
    let mut ferns = ferns(settings());
    for i in 0..12u16 {
        let step = f32::from(i) * 0.25;
        let pose = Se3::exp([f64::from(i), -0.3, 0.2, 0.1, 0.1 * f64::from(i), 0.0]);
        let view = wall(0.5 + step, 3.5 - step);
        let submap = if i == 0 || i == 11 { 9 } else { i / 4 };
        assert!(matches!(ferns.harvest(&view, submap, &pose, Timestamp(-7)).unwrap(), Harvest::Added { .. }));
    }
    assert_eq!(ferns.remove_submap(9), 2);
    ferns
}

/// The bytes with a checksum that fits whatever they are.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 4;
    let checksum = crc32fast::hash(&bytes[..end]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Where the number of the next keyframe stands, followed by how many there are.
fn counts_at(bytes: &[u8]) -> usize {
    16 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize
}

fn load_error(bytes: &[u8]) -> Error {
    let mut ferns = filled();
    let error = ferns.load(bytes).unwrap_err();
    assert_eq!(ferns.save(), filled().save(), "what was there must stay");
    error
}

#[test]
fn what_was_saved_answers_as_before_and_saves_as_the_same_bytes() {
    let mut original = filled();
    let mut loaded = ferns(settings());
    loaded.load(&original.save()).unwrap();
    assert_eq!(loaded.save(), original.save());
    assert_eq!(loaded.keyframes(), original.keyframes());
    for i in 0..20 {
        let view = wall(0.3 + 0.17 * i as f32, 2.0);
        let answers = |ferns: &Ferns| ferns.candidates(&view, 5, &|_| true).unwrap();
        assert_eq!(answers(&loaded), answers(&original));
        let harvest = |ferns: &mut Ferns| ferns.harvest(&view, 4, &Se3::IDENTITY, Timestamp(i)).unwrap();
        assert_eq!(harvest(&mut loaded), harvest(&mut original));
    }
    assert!(loaded.keyframes().iter().any(|keyframe| keyframe.id == 12), "numbers go on where they were");
    assert_eq!(loaded.save(), original.save());
    let mut empty = ferns(settings());
    empty.load(&ferns(settings()).save()).unwrap();
    assert_eq!(empty.keyframes(), []);
}

#[test]
fn a_setting_that_differs_is_named_with_both_values() {
    let saved = filled().save();
    let other = Settings { relocaliser: settings(), ..Settings::default() };
    type Change = fn(&mut Settings);
    let changes: [(&str, Change, &str, &str); 9] = [
        ("relocaliser.image", |s| s.relocaliser.image = RelocaliserImage::Both, "both", "depth"),
        ("relocaliser.width", |s| s.relocaliser.width = 80, "80", "40"),
        ("relocaliser.height", |s| s.relocaliser.height = 60, "60", "30"),
        ("relocaliser.smoothing_px", |s| s.relocaliser.smoothing_px = 0.5, "0.5", "2.5"),
        ("relocaliser.ferns", |s| s.relocaliser.ferns = 71, "71", "70"),
        ("relocaliser.tests", |s| s.relocaliser.tests = 5, "5", "4"),
        ("relocaliser.seed", |s| s.relocaliser.seed = 3, "3", "1"),
        ("view.min_depth_m", |s| s.view.min_depth_m = 0.3, "0.3", "0.2"),
        ("view.max_depth_m", |s| s.view.max_depth_m = 5.0, "5", "4"),
    ];
    for (setting, change, expected, found) in changes {
        let mut changed = other.clone();
        change(&mut changed);
        let error = Ferns::new(&changed).unwrap().load(&saved).unwrap_err();
        let differences = vec![Difference { setting, expected: expected.into(), found: found.into() }];
        assert_eq!(error, Error::SettingsDiffer { differences });
    }
    // All that differ are named at once, where fewer are compared too.
    let mut changed = other.clone();
    changed.relocaliser.image = RelocaliserImage::Colour;
    changed.relocaliser.ferns = 30;
    changed.view.max_depth_m = 5.0;
    let error = Ferns::new(&changed).unwrap().load(&saved).unwrap_err().to_string();
    let expected = "made with relocaliser.image = depth (here colour), relocaliser.ferns = 70 (here 30)";
    assert_eq!(error, format!("saved keyframes were {expected}"));
    let of_colours = Ferns::new(&changed).unwrap().save();
    let error = Ferns::new(&other).unwrap().load(&of_colours).unwrap_err().to_string();
    assert!(error.contains("relocaliser.image = colour (here depth), relocaliser.ferns = 30 (here 70)"), "{error}");
    // What codes do not depend on may differ.
    let mut changed = other;
    changed.relocaliser.min_dissimilarity = 0.5;
    changed.relocaliser.min_valid_share = 0.9;
    Ferns::new(&changed).unwrap().load(&saved).unwrap();
}

#[test]
fn what_is_not_keyframes_says_why() {
    let saved = filled().save();
    let at = counts_at(&saved);
    let damaged = |change: &dyn Fn(&mut Vec<u8>), says: &str| {
        let mut bytes = saved.clone();
        change(&mut bytes);
        let error = load_error(&sealed(bytes)).to_string();
        assert!(error.contains(says), "{error}");
    };
    assert!(load_error(b"").to_string().contains("end after 0 bytes"));
    assert!(load_error(b"itmferns\x01\0\0\0").to_string().contains("checksum"));
    assert!(load_error(b"a different file").to_string().contains("do not begin"));
    damaged(&|bytes| bytes[8] = 9, "have the version 9, and only 1");
    damaged(&|bytes| bytes[12..16].copy_from_slice(&u32::MAX.to_le_bytes()), "4294967295 were expected");
    damaged(&|bytes| bytes[16] = b'X', "the settings that they were made with cannot be read");
    damaged(&|bytes| bytes[16] = 0xff, "the settings that they were made with cannot be read");
    damaged(&|bytes| bytes[at] = 3, "has the number 3, out of order");
    for count in [0, 11, u64::MAX, u64::MAX / 8, 1 << 60] {
        damaged(&|bytes| bytes[at + 4..at + 12].copy_from_slice(&count.to_le_bytes()), "cannot stand in");
    }
    damaged(&|bytes| bytes[at + 12] = 5, "out of order");
    damaged(&|bytes| bytes[at + 26..at + 34].copy_from_slice(&f64::NAN.to_le_bytes()), "the pose of keyframe 1");
    damaged(&|bytes| bytes[at + 26..at + 34].copy_from_slice(&7.0f64.to_le_bytes()), "unit length");
    let row = at + 12 + 70;
    damaged(&|bytes| bytes[row + 15] = 1, "codes of more ferns than there are");
}

#[test]
fn numbers_run_out_as_an_error() {
    let mut saved = filled().save();
    let at = counts_at(&saved);
    saved[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut ferns = ferns(settings());
    ferns.load(&sealed(saved)).unwrap();
    let before = ferns.keyframes().len();
    let harvest = ferns.harvest(&wall(0.2, 0.3), 0, &Se3::IDENTITY, Timestamp(0));
    assert_eq!((harvest, ferns.keyframes().len()), (Err(Error::TooManyKeyframes), before));
}

proptest! {
    #[test]
    fn bytes_that_are_cut_off_or_changed_are_an_error(cut: prop::sample::Index, at: prop::sample::Index, flip in 1..=255u8) {
        let saved = filled().save();
        load_error(&saved[..cut.index(saved.len())]);
        let mut changed = saved;
        let at = at.index(changed.len());
        changed[at] ^= flip;
        load_error(&changed);
    }

    /// Also what a checksum cannot find: it is loaded, or an error, and what is loaded can be used.
    #[test]
    fn bytes_with_a_fitting_checksum_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = filled().save();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(4 + cut.index(bytes.len() - 4));
        }
        let mut ferns = ferns(settings());
        if ferns.load(&sealed(bytes)).is_ok() {
            let found = ferns.candidates(&wall(1.0, 2.0), 5, &|_| true).unwrap();
            prop_assert!(found.iter().all(|found| (0.0..1.0).contains(&found.dissimilarity)));
        }
    }
}
