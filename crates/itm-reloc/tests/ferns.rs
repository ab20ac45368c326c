//! What a relocaliser by ferns promises.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use common::{ferns, wall};
use glam::{DQuat, DVec3};
use itm_core::{
    ColourImage, Image, Intrinsics, RelocaliserImage, RelocaliserKind, RelocaliserSettings, Se3, Settings, Timestamp,
};
use itm_reloc::{Error, Ferns, Harvest, Relocaliser, SmallView, new_relocaliser};

const HERE: Se3 = Se3::IDENTITY;

fn id(harvest: Harvest) -> u32 {
    match harvest {
        Harvest::Added { id, .. } => id,
        other => panic!("{other:?} is no new keyframe"),
    }
}

fn harvest(relocaliser: &mut Ferns, view: &SmallView, submap: u16) -> Harvest {
    relocaliser.harvest(view, submap, &HERE, Timestamp(0)).unwrap()
}

#[test]
fn keyframes_of_equal_dissimilarity_come_in_the_order_of_their_numbers() {
    // Few ferns, so that there are some.
    let mut ferns = ferns(RelocaliserSettings { min_dissimilarity: 0.0, ferns: 40, tests: 1, ..Default::default() });
    let views: Vec<_> = (0..30).map(|i| wall(0.5 + 0.1 * i as f32, 3.5 - 0.1 * i as f32)).collect();
    views.iter().for_each(|view| {
        harvest(&mut ferns, view, 0);
    });
    let found = ferns.candidates(&views[15], 30, &|_| true).unwrap();
    let order: Vec<_> = found.iter().map(|found| (found.dissimilarity, found.keyframe.id)).collect();
    assert!(order.is_sorted() && order.windows(2).any(|pair| pair[0].0 == pair[1].0), "{order:?}");
}

#[test]
fn of_a_view_from_elsewhere_only_what_is_known_is_compared() {
    let camera = Intrinsics::new(40, 30, 33.0, 33.0, 19.5, 14.5);
    let mut ferns = ferns(RelocaliserSettings::default());
    let view = wall(1.0, 2.5);
    id(harvest(&mut ferns, &view, 0));
    // A third of it is turned away, and what comes into view instead is unknown: that is no difference.
    let there = Se3::exp([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]);
    let turned = view.seen_from(&camera, &there);
    let unknown = turned.depth().iter().filter(|depth| **depth == 0.0).count();
    assert!((200..600).contains(&unknown), "{unknown} of 1200 pixels are unknown");
    let back = turned.seen_from(&camera, &there.inverse());
    let found = ferns.candidates(&back, 1, &|_| true).unwrap();
    assert!(found[0].dissimilarity < 0.1, "{found:?}");
    let holes = SmallView::new(Image::new(40, 30, back.depth().to_vec()).unwrap(), None).unwrap();
    let with_holes = ferns.candidates(&holes, 1, &|_| true).unwrap();
    assert!(with_holes[0].dissimilarity > 0.25, "{with_holes:?}");
    // Of what has turned away nearly all that it shows, nothing is said.
    let away = view.seen_from(&camera, &Se3::exp([0.0, 0.0, 0.0, 0.0, 0.9, 0.0]));
    assert_eq!(ferns.candidates(&away, 1, &|_| true).unwrap(), []);
    // What is not known of one view is not compared in either order.
    let of_both = ferns.dissimilarity(&back, &view).unwrap();
    assert_eq!((of_both, of_both), (found[0].dissimilarity, ferns.dissimilarity(&view, &back).unwrap()));
    let nothing = view.seen_from(&camera, &Se3::exp([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]));
    assert_eq!(ferns.dissimilarity(&nothing, &view).unwrap(), 1.0);
    // It is no keyframe.
    assert_eq!(ferns.harvest(&turned, 0, &HERE, Timestamp(1)), Err(Error::PartOfAView));
    assert_eq!(ferns.keyframes().len(), 1);
}

#[test]
fn how_much_must_be_known_to_be_compared_is_a_setting() {
    let camera = Intrinsics::new(40, 30, 33.0, 33.0, 19.5, 14.5);
    let view = wall(1.0, 2.5);
    let turned = view.seen_from(&camera, &Se3::exp([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]));
    for (min_compared_share, found) in [(0.0, 1), (1.0, 0)] {
        let mut ferns = ferns(RelocaliserSettings { min_compared_share, ..Default::default() });
        id(harvest(&mut ferns, &view, 0));
        assert_eq!(ferns.candidates(&turned, 1, &|_| true).unwrap().len(), found);
        assert_eq!(ferns.candidates(&view, 1, &|_| true).unwrap().len(), 1, "all of it is known");
    }
}

#[test]
fn the_seed_alone_decides_which_ferns_there_are() {
    let settings = |seed| RelocaliserSettings { seed, ..Default::default() };
    let (a, b) = (wall(1.0, 2.0), wall(1.1, 2.3));
    let between = |seed| ferns(settings(seed)).dissimilarity(&a, &b).unwrap();
    assert_eq!(between(1), between(1));
    assert!((2..12).any(|seed| between(seed) != between(1)));
}

#[test]
fn a_view_that_shows_too_little_is_refused_and_resembles_nothing() {
    let covered =
        SmallView::new(Image::filled(40, 30, 0.0), Some(ColourImage::filled(40, 30, [0, 0, 0, 255]))).unwrap();
    let uncoloured = SmallView::new(Image::filled(40, 30, 2.0), None).unwrap();
    for (image, covered_share, uncoloured_share) in [
        (RelocaliserImage::Depth, Some(0.0), None),
        (RelocaliserImage::Colour, None, Some(0.0)),
        (RelocaliserImage::Both, Some(0.0), Some(0.0)),
    ] {
        let mut ferns = ferns(RelocaliserSettings { image, ..Default::default() });
        // A near wall: to most tests like a covered lens.
        id(harvest(&mut ferns, &wall(0.25, 0.3), 0));
        for (view, share) in [(&covered, covered_share), (&uncoloured, uncoloured_share)] {
            let Some(valid_share) = share else {
                assert!(!ferns.candidates(view, 1, &|_| true).unwrap().is_empty(), "{image:?}");
                continue;
            };
            assert_eq!(harvest(&mut ferns, view, 0), Harvest::Blind { valid_share });
            assert_eq!(ferns.candidates(view, 1, &|_| true).unwrap(), []);
        }
    }
    let mut all_taken = ferns(RelocaliserSettings { min_valid_share: 0.0, ..Default::default() });
    id(harvest(&mut all_taken, &covered, 0));
}

#[test]
fn submaps_go_and_poses_move() {
    let mut ferns = ferns(RelocaliserSettings::default());
    let views = [wall(0.5, 0.5), wall(3.5, 3.5), wall(0.5, 3.5)];
    let ids: Vec<_> = views.iter().zip([0, 7, 0]).map(|(view, submap)| id(harvest(&mut ferns, view, submap))).collect();
    let there = Se3::new(DQuat::from_rotation_y(0.5), DVec3::new(1.0, 2.0, 3.0));
    ferns.set_pose(ids[1], &there).unwrap();
    assert_eq!(ferns.keyframe(ids[1]).unwrap().submap_from_camera, there);
    assert_eq!(ferns.candidates(&views[1], 1, &|_| true).unwrap()[0].keyframe.submap_from_camera, there);
    let elsewhere = ferns.candidates(&views[1], 1, &|keyframe| keyframe.submap != 7).unwrap();
    assert!(elsewhere.iter().all(|found| found.keyframe.id != ids[1]));

    assert_eq!((ferns.remove_submap(0), ferns.remove_submap(0)), (2, 0));
    assert_eq!(ferns.keyframes().iter().map(|keyframe| keyframe.id).collect::<Vec<_>>(), [ids[1]]);
    assert_eq!(ferns.candidates(&views[1], 5, &|_| true).unwrap()[0].keyframe.id, ids[1]);
    assert_eq!(ferns.set_pose(ids[0], &there), Err(Error::NoKeyframe { id: ids[0] }));
    // A number is never given again.
    assert_eq!(id(harvest(&mut ferns, &views[0], 0)), 3);
}

#[test]
fn what_does_not_fit_is_an_error_and_changes_nothing() {
    let mut ferns = ferns(RelocaliserSettings::default());
    let other = SmallView::new(Image::filled(30, 40, 1.0), None).unwrap();
    let error = Error::ViewSize { what: "depth", expected: (40, 30), found: (30, 40) };
    assert_eq!(ferns.harvest(&other, 0, &HERE, Timestamp(0)), Err(error.clone()));
    assert_eq!(ferns.candidates(&other, 1, &|_| true), Err(error.clone()));
    assert!(error.to_string().contains("40x30 pixels, not 30x40"), "{error}");
    let nowhere = Se3 { translation: DVec3::NAN, ..HERE };
    assert!(matches!(ferns.harvest(&wall(1.0, 2.0), 0, &nowhere, Timestamp(0)), Err(Error::Pose(_))));
    assert_eq!(ferns.keyframes(), []);
    let settings = RelocaliserSettings { ferns: 0, ..Default::default() };
    let refused = Ferns::new(&Settings { relocaliser: settings, ..Settings::default() });
    assert!(matches!(refused, Err(Error::Settings(_))));
}

#[test]
fn the_settings_choose_a_relocaliser_or_none() {
    let mut settings = Settings::default();
    let mut chosen = new_relocaliser(&settings).unwrap().unwrap();
    chosen.harvest(&wall(1.0, 2.0), 0, &HERE, Timestamp(5)).unwrap();
    assert_eq!(chosen.keyframe(0).unwrap().timestamp, Timestamp(5));
    settings.relocaliser.kind = RelocaliserKind::Off;
    assert!(new_relocaliser(&settings).unwrap().is_none());
}
