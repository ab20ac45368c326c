//! Reference of stage `changed`: which frame last changed each block. Frames are numbered from 1; 0 is none.

/// A frame changes the visible blocks (`last_changed` by block index).
pub fn mark(last_changed: &mut [u32], visible: &[u32], frame: u32) {
    for block in visible {
        last_changed[*block as usize] = frame;
    }
}

/// Blocks come back, each to the place in `places` (`None` where it found no room), with the frame that last changed it. One
/// that meets a block that was fused into there meanwhile is changed by this frame.
pub fn arrive(last_changed: &mut [u32], places: &[Option<u32>], changed: &[u32], frame: u32) {
    for (place, changed) in places.iter().zip(changed) {
        let Some(place) = place else { continue };
        let held = &mut last_changed[*place as usize];
        *held = if *held == 0 { *changed } else { frame };
    }
}
