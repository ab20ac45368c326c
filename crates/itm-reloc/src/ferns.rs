//! Random ferns.

mod codes;
mod draw;
mod saved;
#[cfg(test)]
mod tests;

use itm_core::{RelocaliserImage, RelocaliserSettings, Se3, Settings, Timestamp};

use crate::{Candidate, Error, Harvest, Keyframe, Relocaliser, SmallView};
use codes::CodeTable;
use draw::Test;

/// Keyframes told apart by random ferns (Glocker et al. 2015).
///
/// A fern is a few binary tests of the small view, each whether one pixel's depth or one of its colours is above a threshold;
/// their outcomes are the fern's code. Pixels and thresholds are drawn once, from the settings' seed: thresholds evenly between
/// `view.min_depth_m` and `max_depth_m`, and between 0 and 255. The dissimilarity of two views is the share of ferns whose codes
/// differ, the block-wise Hamming distance.
///
/// With `relocaliser.image = "colour"` the tests of a fern look at red, green, blue in turn, with `both` at depth, red, green, blue,
/// so that with four tests each fern asks once for each of them, as in the paper.
///
/// A pixel without depth reads as 0, and one without colour as black: the test's outcome is 0. A hole in the depth is thus
/// part of what a view looks like, which is right for windows and for what is out of range. The price is that views
/// which hardly show anything resemble each other, and near walls too, whose depths lie below most thresholds. Therefore a
/// view with less than `relocaliser.min_valid_share` of valid pixels neither becomes a keyframe nor has candidates. Of a covered
/// lens that is known by its depth; where colour alone is compared, it is dark and not without colour.
///
/// All keyframes' codes are compared with a view's, which gives what the paper's code tables would: those whose number stands
/// in none of the tables at the view's codes have dissimilarity 1 and are left out.
#[derive(Clone, Debug)]
pub struct Ferns {
    settings: RelocaliserSettings,
    /// What codes depend on: the full keys of settings with their values.
    made_with: Vec<(&'static str, String)>,
    tests: Vec<Test>,
    keyframes: Vec<Keyframe>,
    /// A row a keyframe, in the same order.
    codes: CodeTable,
    next_id: u32,
}

impl Ferns {
    /// Draws the ferns that `settings.relocaliser` and the depth range of `settings.view` ask for.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(settings: &Settings) -> Result<Self, Error> {
        settings.validate()?;
        let relocaliser = settings.relocaliser.clone();
        Ok(Self {
            made_with: saved::made_with(settings),
            tests: draw::tests(settings),
            keyframes: Vec::new(),
            codes: CodeTable::new(relocaliser.ferns as usize, relocaliser.tests as usize),
            next_id: 0,
            settings: relocaliser,
        })
    }

    /// The dissimilarity of two views, 0 to 1: the share of ferns whose codes differ, of those that look at nothing but what both
    /// tell of; 1 where there are none.
    ///
    /// # Errors
    /// A view of the wrong size.
    pub fn dissimilarity(&self, one: &SmallView, other: &SmallView) -> Result<f64, Error> {
        let (one_row, other_row) = (self.encode(one)?, self.encode(other)?);
        let mask: Vec<u64> = self.compared(one).iter().zip(self.compared(other)).map(|(a, b)| a & b).collect();
        Ok(match ferns_in(&mask) {
            0 => 1.0,
            compared => f64::from(self.codes.differing(&one_row, &other_row, &mask)) / f64::from(compared),
        })
    }

    /// A view's codes, in the form of a [`CodeTable`]'s row.
    fn encode(&self, view: &SmallView) -> Result<Vec<u64>, Error> {
        let expected = (self.settings.width, self.settings.height);
        if view.size() != expected {
            return Err(Error::ViewSize { what: "depth", expected, found: view.size() });
        }
        Ok(self.codes.row(self.tests.iter().map(|test| test.outcome(view))))
    }

    /// Share of the pixels at which there is something to test: of both images, the one that shows less counts.
    fn valid_share(&self, view: &SmallView) -> f64 {
        match self.settings.image {
            RelocaliserImage::Depth => view.depth_share(),
            RelocaliserImage::Colour => view.colour_share(),
            RelocaliserImage::Both => view.depth_share().min(view.colour_share()),
        }
    }

    /// The ferns that a view can be compared by: those that look at nothing but what it tells of.
    fn compared(&self, view: &SmallView) -> Vec<u64> {
        self.codes.mask(self.tests.iter().map(|test| view.is_known(test.pixel as usize)))
    }

    /// The keyframes with the most codes in common with a view's, of the ferns in a mask, in the order of
    /// [`Relocaliser::candidates`].
    fn nearest(&self, row: &[u64], mask: &[u64], count: usize, accept: &dyn Fn(&Keyframe) -> bool) -> Vec<Candidate> {
        // Ferns that differ, and the keyframe's index; the nearest first.
        let mut nearest: Vec<(u32, usize)> = Vec::new();
        let compared = ferns_in(mask);
        let mut below = if count == 0 { 0 } else { compared };
        self.codes.compare(row, mask, |index, differing| {
            if differing < below && accept(&self.keyframes[index]) {
                // Behind its equals, whose numbers are smaller.
                let at = nearest.partition_point(|&(other, _)| other <= differing);
                nearest.truncate(count - 1);
                nearest.insert(at, (differing, index));
                if nearest.len() == count {
                    below = nearest[count - 1].0;
                }
            }
        });
        let candidate = |(differing, index): (u32, usize)| Candidate {
            keyframe: self.keyframes[index],
            dissimilarity: f64::from(differing) / f64::from(compared),
        };
        nearest.into_iter().map(candidate).collect()
    }
}

impl Relocaliser for Ferns {
    fn harvest(
        &mut self,
        view: &SmallView,
        submap: u16,
        submap_from_camera: &Se3,
        timestamp: Timestamp,
    ) -> Result<Harvest, Error> {
        check_pose(submap_from_camera)?;
        if !view.is_whole() {
            return Err(Error::PartOfAView);
        }
        let row = self.encode(view)?;
        let valid_share = self.valid_share(view);
        if valid_share < self.settings.min_valid_share {
            return Ok(Harvest::Blind { valid_share });
        }
        // What looks alike elsewhere must not keep a place from being remembered: opposite walls of a room would.
        let (within_m, within_rad) = (self.settings.place_within_m, self.settings.place_within_rad);
        let same_place = |keyframe: &Keyframe| {
            let between = keyframe.submap_from_camera.inverse() * *submap_from_camera;
            let near = between.translation.length() <= within_m && between.angle() <= within_rad;
            keyframe.submap == submap && near
        };
        let nearest = self.nearest(&row, &self.compared(view), 1, &same_place).pop();
        match nearest {
            Some(nearest) if nearest.dissimilarity <= self.settings.min_dissimilarity => Ok(Harvest::Known { nearest }),
            _ => {
                let id = self.next_id;
                self.next_id = id.checked_add(1).ok_or(Error::TooManyKeyframes)?;
                self.keyframes.push(Keyframe { id, submap, submap_from_camera: *submap_from_camera, timestamp });
                self.codes.push(&row);
                Ok(Harvest::Added { id, nearest })
            }
        }
    }

    fn candidates(
        &self,
        view: &SmallView,
        count: usize,
        accept: &dyn Fn(&Keyframe) -> bool,
    ) -> Result<Vec<Candidate>, Error> {
        let row = self.encode(view)?;
        if self.valid_share(view) < self.settings.min_valid_share {
            return Ok(Vec::new());
        }
        let mask = self.compared(view);
        if f64::from(ferns_in(&mask)) < self.settings.min_compared_share * f64::from(self.settings.ferns) {
            return Ok(Vec::new());
        }
        Ok(self.nearest(&row, &mask, count, accept))
    }

    fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    fn set_pose(&mut self, id: u32, submap_from_camera: &Se3) -> Result<(), Error> {
        check_pose(submap_from_camera)?;
        let at = self.keyframes.binary_search_by_key(&id, |keyframe| keyframe.id);
        let at = at.map_err(|_| Error::NoKeyframe { id })?;
        self.keyframes[at].submap_from_camera = *submap_from_camera;
        Ok(())
    }

    fn remove_submap(&mut self, submap: u16) -> usize {
        let before = self.keyframes.len();
        self.codes.retain(|index| self.keyframes[index].submap != submap);
        self.keyframes.retain(|keyframe| keyframe.submap != submap);
        before - self.keyframes.len()
    }

    fn save(&self) -> Vec<u8> {
        saved::write(&self.made_with, self.next_id, &self.keyframes, &self.codes)
    }

    fn load(&mut self, saved: &[u8]) -> Result<(), Error> {
        let empty = CodeTable::new(self.settings.ferns as usize, self.settings.tests as usize);
        (self.next_id, self.keyframes, self.codes) = saved::read(saved, &self.made_with, empty)?;
        Ok(())
    }
}

/// Ferns in a mask.
fn ferns_in(mask: &[u64]) -> u32 {
    mask.iter().map(|word| word.count_ones()).sum()
}

/// Whether a pose can be kept. It is kept as given: normalising it again could change its last digits.
fn check_pose(pose: &Se3) -> Result<(), Error> {
    Se3::try_from_quaternion(pose.rotation, pose.translation)?;
    Ok(())
}
