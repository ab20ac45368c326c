//! Ferns against the code tables of the paper, written for reading.

use std::collections::{BTreeMap, BTreeSet};

use itm_core::{ColourImage, Image};
use proptest::prelude::*;

use super::*;

/// The paper's layout: for each fern a table from codes to the keyframes that have them.
struct CodeTables {
    tests: Vec<Vec<Test>>,
    tables: Vec<BTreeMap<Vec<bool>, BTreeSet<u32>>>,
}

impl CodeTables {
    fn new(ferns: &Ferns) -> Self {
        let tests: Vec<_> = ferns.tests.chunks(ferns.settings.tests as usize).map(<[Test]>::to_vec).collect();
        Self { tables: vec![BTreeMap::new(); tests.len()], tests }
    }

    fn codes(&self, view: &SmallView) -> Vec<Vec<bool>> {
        self.tests.iter().map(|fern| fern.iter().map(|test| test.outcome(view)).collect()).collect()
    }

    fn insert(&mut self, id: u32, view: &SmallView) {
        let codes = self.codes(view);
        for (table, code) in self.tables.iter_mut().zip(codes) {
            table.entry(code).or_insert_with(BTreeSet::new).insert(id);
        }
    }

    fn remove(&mut self, id: u32) {
        self.tables.iter_mut().flat_map(BTreeMap::values_mut).for_each(|ids| {
            ids.remove(&id);
        });
    }

    /// All keyframes that share a code with the view: dissimilarity and number, in this order.
    fn nearest(&self, view: &SmallView) -> Vec<(f64, u32)> {
        let mut shared = BTreeMap::<u32, usize>::new();
        for (table, code) in self.tables.iter().zip(self.codes(view)) {
            for id in table.get(&code).into_iter().flatten() {
                *shared.entry(*id).or_default() += 1;
            }
        }
        let ferns = self.tables.len();
        let mut all: Vec<_> = shared.into_iter().map(|(id, n)| ((ferns - n) as f64 / ferns as f64, id)).collect();
        all.sort_by(|a, b| a.partial_cmp(b).unwrap());
        all
    }
}

/// A view of 8x6 pixels of random depths and colours, a quarter of which are not there.
fn view() -> impl Strategy<Value = SmallView> {
    let depth = prop::collection::vec(prop_oneof![3 => 0.2..4.0f32, 1 => Just(0.0)], 48);
    let colour = prop::collection::vec((any::<[u8; 3]>(), prop::bool::weighted(0.75)), 48);
    (depth, prop::option::weighted(0.9, colour)).prop_map(|(depth, colour)| {
        let pixel = |([r, g, b], valid): ([u8; 3], bool)| [r, g, b, u8::from(valid)];
        let image = |colour: Vec<_>| ColourImage::new(8, 6, colour.into_iter().map(pixel).collect()).unwrap();
        SmallView::new(Image::new(8, 6, depth).unwrap(), colour.map(image)).unwrap()
    })
}

fn settings() -> impl Strategy<Value = Settings> {
    (prop::sample::select(&RelocaliserImage::ALL), 1..200u32, 1..=8u32, any::<u32>(), 0.0..0.6).prop_map(
        |(image, ferns, tests, seed, min_dissimilarity)| {
            let (width, height) = (8, 6);
            let min_valid_share = 0.0;
            let relocaliser = RelocaliserSettings {
                image,
                width,
                height,
                ferns,
                tests,
                seed,
                min_dissimilarity,
                min_valid_share,
                ..Default::default()
            };
            Settings { relocaliser, ..Settings::default() }
        },
    )
}

proptest! {
    #[test]
    fn nearest_keyframes_are_those_of_the_code_tables(
        settings in settings(),
        views in prop::collection::vec(view(), 1..25),
        picks in prop::collection::vec((0..25usize, 0..48usize, 0.2..4.0f32), 1..60),
        count in 0..8usize,
    ) {
        let mut ferns = Ferns::new(&settings).unwrap();
        let mut tables = CodeTables::new(&ferns);
        for (step, (pick, pixel, depth)) in picks.into_iter().enumerate() {
            // Some view with one pixel changed, so that near ones come too.
            let picked = &views[pick % views.len()];
            let mut image = Image::new(8, 6, picked.depth().to_vec()).unwrap();
            image.data_mut()[pixel] = depth;
            let colour = picked.colour().map(|colour| ColourImage::new(8, 6, colour.to_vec()).unwrap());
            let view = SmallView::new(image, colour).unwrap();

            let expected = tables.nearest(&view);
            let found = ferns.candidates(&view, count, &|_| true).unwrap();
            let found: Vec<_> = found.iter().map(|found| (found.dissimilarity, found.keyframe.id)).collect();
            prop_assert_eq!(&found[..], &expected[..count.min(expected.len())]);
            let found = ferns.candidates(&view, count, &|keyframe| keyframe.submap != 1).unwrap();
            let without = expected.iter().filter(|(_, id)| ferns.keyframe(*id).unwrap().submap != 1).take(count);
            prop_assert!(found.iter().map(|found| (found.dissimilarity, found.keyframe.id)).eq(without.copied()));

            let submap = step as u16 % 3;
            let first = expected.iter().find(|(_, id)| ferns.keyframe(*id).unwrap().submap == submap);
            let harvest = ferns.harvest(&view, submap, &Se3::IDENTITY, Timestamp(step as i64)).unwrap();
            match (harvest, first) {
                (Harvest::Added { id, nearest }, first) => {
                    prop_assert!(first.is_none_or(|first| first.0 > settings.relocaliser.min_dissimilarity));
                    prop_assert_eq!(nearest.map(|n| (n.dissimilarity, n.keyframe.id)), first.copied());
                    tables.insert(id, &view);
                }
                (Harvest::Known { nearest }, Some(first)) => {
                    prop_assert!(first.0 <= settings.relocaliser.min_dissimilarity);
                    prop_assert_eq!((nearest.dissimilarity, nearest.keyframe.id), *first);
                }
                other => prop_assert!(false, "{:?}", other),
            }
            if step % 20 == 19 {
                let gone: Vec<_> = ferns.keyframes().iter().filter(|k| k.submap == 2).map(|k| k.id).collect();
                prop_assert_eq!(ferns.remove_submap(2), gone.len());
                gone.into_iter().for_each(|id| tables.remove(id));
            }
        }
    }

    #[test]
    fn dissimilarity_is_a_metric_of_codes(settings in settings(), a in view(), b in view(), c in view()) {
        let ferns = Ferns::new(&settings).unwrap();
        let between = |a, b| ferns.dissimilarity(a, b).unwrap();
        prop_assert_eq!(between(&a, &a), 0.0);
        prop_assert!((0.0..=1.0).contains(&between(&a, &b)));
        prop_assert_eq!(between(&a, &b), between(&b, &a));
        prop_assert!(between(&a, &c) <= between(&a, &b) + between(&b, &c) + 1e-12);
        let codes = |view| CodeTables::new(&ferns).codes(view);
        let differing = codes(&a).iter().zip(codes(&b)).filter(|(a, b)| *a != b).count();
        prop_assert_eq!(between(&a, &b), differing as f64 / f64::from(settings.relocaliser.ferns));
    }
}
