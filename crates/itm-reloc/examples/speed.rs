//! How long a frame takes among many keyframes: medians of harvesting, of finding candidates, of finding them as the view would look
//! from 20 other places too, which a lost frame does, and of saving and loading.
//!
//! `cargo run --release -p itm-reloc --example speed -- 10000`

#![allow(clippy::print_stdout, reason = "this is a program")]

use std::time::{Duration, Instant};

use itm_core::{Image, Intrinsics, RelocaliserImage, RelocaliserSettings, Se3, Settings, Timestamp};
use itm_reloc::{Error, Ferns, Relocaliser as _, SmallView};
use rand::Rng as _;
use rand_pcg::Pcg32;

/// A smooth view of things 0.5 to 3.5 m away, of many colours.
fn view(random: &mut Pcg32) -> Result<SmallView, Error> {
    let mut wave = || {
        let [u, v, phase] = std::array::from_fn(|_| f64::from(random.next_u32()) / f64::from(u32::MAX));
        move |x: u32, y: u32| (0.3 * u * f64::from(x) + 0.3 * v * f64::from(y) + 6.3 * phase).sin()
    };
    let (coarse, fine, red) = (wave(), wave(), wave());
    let depth = Image::from_fn(40, 30, |x, y| (2.0 + coarse(x, y) + 0.5 * fine(x, y)) as f32);
    let byte = |value: f64| (127.5 + 127.5 * value) as u8;
    let colour =
        Image::from_fn(40, 30, |x, y| [byte(red(x, y)), byte(fine(x, y)), byte(coarse(x, y) * red(x, y)), 255]);
    SmallView::new(depth, Some(colour))
}

fn median(mut times: Vec<Duration>) -> f64 {
    times.sort_unstable();
    times[times.len() / 2].as_secs_f64() * 1e3
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let keyframes: usize = std::env::args().nth(1).map_or(Ok(10_000), |count| count.parse())?;
    println!("{keyframes} keyframes; medians in milliseconds");
    println!("| ferns x tests | image | harvest | 16 candidates | lost: 21 x 64 | save | load | MiB |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let camera = Intrinsics::new(40, 30, 33.0, 33.0, 19.5, 14.5);
    for (ferns, image) in
        [(500, RelocaliserImage::Depth), (1000, RelocaliserImage::Depth), (1000, RelocaliserImage::Both)]
    {
        let relocaliser = RelocaliserSettings { ferns, image, min_dissimilarity: 0.0, ..Default::default() };
        let settings = Settings { relocaliser, ..Settings::default() };
        let mut ferns = Ferns::new(&settings)?;
        let mut random = Pcg32::new(7, 0);
        while ferns.keyframes().len() < keyframes {
            ferns.harvest(&view(&mut random)?, 0, &Se3::IDENTITY, Timestamp(0))?;
        }
        let (mut harvests, mut look_ups, mut lost) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..200 {
            let view = view(&mut random)?;
            let (found, time) = timed(|| ferns.candidates(&view, 16, &|_| true));
            found?;
            look_ups.push(time);
            let moves = (0..20_u8).map(|at| Se3::exp([0.0, 0.0, 0.03 * f64::from(at), 0.0, 0.02 * f64::from(at), 0.0]));
            let (found, time) = timed(|| {
                ferns.candidates(&view, 64, &|_| true)?;
                moves
                    .map(|at| ferns.candidates(&view.seen_from(&camera, &at), 64, &|_| true))
                    .collect::<Result<Vec<_>, _>>()
            });
            found?;
            lost.push(time);
            let (harvest, time) = timed(|| ferns.harvest(&view, 0, &Se3::IDENTITY, Timestamp(0)));
            harvest?;
            harvests.push(time);
        }
        let (saved, saving) = timed(|| ferns.save());
        let (loaded, loading) = timed(|| ferns.load(&saved));
        loaded?;
        println!(
            "| {} x {} | {} | {:.3} | {:.3} | {:.1} | {:.1} | {:.1} | {:.1} |",
            settings.relocaliser.ferns,
            settings.relocaliser.tests,
            image.name(),
            median(harvests),
            median(look_ups),
            median(lost),
            median(vec![saving]),
            median(vec![loading]),
            saved.len() as f64 / f64::from(1 << 20),
        );
    }
    Ok(())
}
