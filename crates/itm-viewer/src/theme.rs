//! Colours that mean something, the same on light and dark.

use egui::Color32;
use itm_slam::SubmapState;

use crate::engine::state::{Kind, Verdict};

/// Of what is the reconstruction's: trajectory, frame time.
pub(crate) const ACCENT: Color32 = Color32::from_rgb(255, 170, 40);
/// Of edges between submaps.
pub(crate) const LINK: Color32 = Color32::from_rgb(150, 150, 160);
/// Of those that closed a loop.
pub(crate) const CLOSURE: Color32 = Color32::from_rgb(230, 80, 200);
/// Of keyframes.
pub(crate) const KEYFRAME: Color32 = Color32::from_rgb(90, 190, 230);

/// Of lines in plots.
pub(crate) const SERIES: [Color32; 6] = [
    Color32::from_rgb(80, 150, 230),
    Color32::from_rgb(110, 190, 80),
    Color32::from_rgb(220, 90, 80),
    Color32::from_rgb(170, 120, 220),
    Color32::from_rgb(60, 190, 180),
    Color32::from_rgb(200, 130, 80),
];

/// Of a verdict.
pub(crate) const fn verdict(verdict: Verdict) -> Color32 {
    match verdict {
        Verdict::Good => Color32::from_rgb(70, 180, 80),
        Verdict::Poor => Color32::from_rgb(235, 180, 40),
        Verdict::Lost => Color32::from_rgb(225, 60, 50),
        Verdict::Unjudged => Color32::from_rgb(140, 140, 150),
    }
}

/// Of a submap.
pub(crate) const fn submap(state: SubmapState) -> Color32 {
    match state {
        SubmapState::Primary => Color32::from_rgb(255, 170, 40),
        SubmapState::Active => Color32::from_rgb(110, 190, 80),
        SubmapState::Passive => Color32::from_rgb(150, 170, 200),
    }
}

/// Of a message.
pub(crate) const fn message(kind: Kind) -> Color32 {
    match kind {
        Kind::Event => Color32::from_rgb(120, 150, 190),
        Kind::Done => Color32::from_rgb(70, 180, 80),
        Kind::Warning => Color32::from_rgb(235, 180, 40),
        Kind::Error => Color32::from_rgb(225, 60, 50),
    }
}
