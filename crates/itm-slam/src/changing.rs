//! Settings that change while a session runs.

use itm_core::Settings;

use crate::{Error, Slam};

impl Slam {
    /// Takes over what takes effect at once (see [`itm_core::LIVE_SETTINGS`]), from the next frame on, and leaves everything
    /// else as it was. The full keys of settings that differ and need another session, sorted.
    ///
    /// What a session was begun with is not always what was asked for, as where a recording has no colour: give
    /// `wanted` through [`Session::fit`](crate::Session::fit) first, or such settings seem to differ.
    ///
    /// # Errors
    /// Where the settings cannot be used, or not together with those that stay. Nothing changes then.
    pub fn change_settings(&mut self, wanted: &Settings) -> Result<Vec<String>, Error> {
        let (settings, others) = self.settings.with_live(wanted)?;
        if settings == self.settings {
            return Ok(others);
        }
        let beside = self.beside.iter_mut().map(|beside| &mut beside.local);
        for local in std::iter::once(&mut self.primary).chain(beside) {
            local.tracker.change_settings(&settings);
        }
        if let Some(places) = &mut self.places {
            places.change_settings(&settings);
        }
        if let Some(atlas) = &mut self.atlas {
            atlas.settings = settings.submaps.clone();
        }
        self.mapper.change_settings(&settings);
        self.settings = settings;
        Ok(others)
    }
}

#[cfg(test)]
mod tests {
    use itm_core::{Mode, OnFailure, TrackerKind};
    use itm_gpu::Device;
    use itm_synth::{Path, Sequence, Spec};

    use super::*;
    use crate::{FrameStatus, Poses};

    #[test]
    fn a_running_session_takes_over_what_it_can_and_names_the_rest() {
        if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
            return;
        }
        let device = Device::open("auto").expect("GPU tests need an adapter; a software driver will do");
        let sequence = Sequence::new(Spec::new(Path::Loop).with_size(80, 60).with_frames(8)).expect("it is valid");
        let mut settings = Settings { mode: Mode::LoopClosure, ..Settings::default() };
        (settings.map.voxel_size_m, settings.map.truncation_m) = (0.04, 0.16);
        settings.tracker.kind = TrackerKind::Composite;
        let mut slam =
            Slam::new(&device, &sequence.calibration(), &settings, Poses::Tracked).expect("a small map fits");
        let mut frames = sequence.frames();
        let mut next = |slam: &mut Slam| slam.process(&frames.next().expect("a frame")).expect("a result");
        assert!((0..3).all(|_| next(&mut slam).fused));

        let mut wanted = settings.clone();
        (wanted.map.fuse, wanted.map.voxel_size_m) = (false, 0.02);
        wanted.submaps.max_drift = 0.1;
        assert_eq!(slam.change_settings(&wanted).expect("they are valid"), ["map.voxel_size_m"]);
        assert_eq!(slam.settings().map.voxel_size_m, 0.04);
        assert_eq!(slam.atlas.as_ref().map(|atlas| atlas.settings.max_drift), Some(0.1));
        let looked_at = next(&mut slam);
        assert!(!looked_at.fused && looked_at.status == FrameStatus::Tracked, "{:?}", looked_at.status);

        // The parts that the tracker is made of know it too: no frame has so many pairs.
        wanted.map.fuse = true;
        wanted.tracker.extended.min_pairs = u32::MAX;
        wanted.tracker.on_failure = OnFailure::StopIntegrating;
        slam.change_settings(&wanted).expect("they are valid");
        let lost = next(&mut slam);
        assert!(matches!(lost.status, FrameStatus::Lost { .. }) && !lost.fused, "{:?}", lost.status);
        wanted.tracker.extended.min_pairs = settings.tracker.extended.min_pairs;
        slam.change_settings(&wanted).expect("they are valid");
        assert!(next(&mut slam).fused, "nothing is waited for after a loss");

        wanted.map.colour_band = 2.0;
        assert!(slam.change_settings(&wanted).is_err());
        assert_eq!(slam.settings().map.colour_band, settings.map.colour_band);
    }
}
