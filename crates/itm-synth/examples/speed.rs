//! Milliseconds that a frame of each path and scene takes to make, with and without colour and noise.
//!
//! ```sh
//! cargo run --release -p itm-synth --example speed -- 12      # frames of each
//! ```

#![allow(clippy::print_stdout, reason = "this is a program")]

use std::time::Instant;

use itm_synth::{DepthNoise, Error, Path, Quality, Sequence, Spec};

fn main() -> Result<(), Error> {
    let frames = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(12);
    println!("{} threads", rayon::current_num_threads());
    println!("{:<10} {:<12} {:>8} {:>8} {:>8} {:>8} {:>8}", "path", "scene", "size", "depth", "noisy", "draft", "fine");
    for path in Path::ALL.into_iter().filter(|path| !matches!(path, Path::Shake | Path::Covered | Path::Kidnapped)) {
        for &scene in path.scenes() {
            for (width, height) in [(160, 120), (320, 240)] {
                let base = Spec { scene, ..Spec::new(path).with_size(width, height) };
                let depth = Spec { colour: false, ..base };
                let noisy = depth.with_noise(DepthNoise::KINECT, 1);
                let mut columns = String::new();
                for spec in [depth, noisy, base, Spec { quality: Quality::Fine, ..base }] {
                    columns += &format!(" {:8.1}", milliseconds(spec, frames)?);
                }
                let size = format!("{width}x{height}");
                println!("{:<10} {:<12} {size:>8}{columns}", path.name(), scene.name());
            }
        }
    }
    Ok(())
}

/// Milliseconds a frame, over frames spread along the path.
fn milliseconds(spec: Spec, frames: u32) -> Result<f64, Error> {
    let sequence = Sequence::new(spec)?;
    let start = Instant::now();
    for i in 0..frames {
        std::hint::black_box(sequence.frame(i * spec.frames / frames));
    }
    Ok(start.elapsed().as_secs_f64() * 1e3 / f64::from(frames))
}
