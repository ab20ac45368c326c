//! Where a frame may have been taken.

use itm_core::{RelocaliserSettings, Se3};
use itm_reloc::Candidate;

use super::poses::is_near;

/// A place where a frame may have been taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Proposal {
    /// What says so.
    pub(super) candidate: Candidate,
    /// In the keyframe's submap.
    pub(super) submap_from_camera: Se3,
}

impl Proposal {
    /// Where the candidate's keyframe was taken.
    pub(super) fn at(candidate: Candidate) -> Self {
        Self { candidate, submap_from_camera: candidate.keyframe.submap_from_camera }
    }

    /// Where a frame was taken that looks from elsewhere as the candidate's keyframe does.
    pub(super) fn seen_from(candidate: Candidate, view_from_moved: &Se3) -> Self {
        let submap_from_camera = candidate.keyframe.submap_from_camera * view_from_moved.inverse();
        Self { candidate, submap_from_camera }
    }

    /// Whether both are of one submap, and within so many metres and radians of each other.
    pub(super) fn is_near(&self, other: &Self, within_m: f64, within_rad: f64) -> bool {
        self.candidate.keyframe.submap == other.candidate.keyframe.submap
            && is_near(&self.submap_from_camera, &other.submap_from_camera, within_m, within_rad)
    }
}

/// The likeliest places, of which no two are near each other; of equally likely ones that which comes first.
pub(super) fn apart(mut all: Vec<Proposal>, own: &RelocaliserSettings) -> Vec<Proposal> {
    all.sort_by(|a, b| a.candidate.dissimilarity.total_cmp(&b.candidate.dissimilarity));
    let mut kept: Vec<Proposal> = Vec::new();
    for proposal in all {
        if kept.len() == own.candidates as usize {
            break;
        }
        if !kept.iter().any(|other| other.is_near(&proposal, own.apart_m, own.apart_rad)) {
            kept.push(proposal);
        }
    }
    kept
}

/// Where coarse tracking leads.
#[derive(Debug)]
pub(super) struct Place {
    /// Over the whole frame, what the map does not show counting as the largest.
    pub(super) error: f64,
    pub(super) proposal: Proposal,
    pub(super) followed_up: bool,
}

impl Place {
    pub(super) fn new(error: f64, proposal: Proposal) -> Self {
        Self { error, proposal, followed_up: false }
    }
}

/// The best first, of those that are the same only the best, but for what was followed up already: that counts for all.
pub(super) fn distinct(mut places: Vec<Place>, own: &RelocaliserSettings) -> Vec<Place> {
    places.sort_by(|a, b| b.followed_up.cmp(&a.followed_up).then(a.error.total_cmp(&b.error)));
    let mut kept: Vec<Place> = Vec::new();
    for place in places {
        let same = |other: &Place| other.proposal.is_near(&place.proposal, own.same_within_m, own.same_within_rad);
        if !kept.iter().any(same) {
            kept.push(place);
        }
    }
    kept.sort_by(|a, b| a.error.total_cmp(&b.error));
    kept
}

#[cfg(test)]
mod tests {
    use itm_core::Timestamp;
    use itm_reloc::Keyframe;

    use super::*;

    fn candidate(id: u32, submap: u16, x: f64, dissimilarity: f64) -> Candidate {
        let submap_from_camera = Se3::exp([x, 0.0, 0.0, 0.0, 0.0, 0.0]);
        Candidate { keyframe: Keyframe { id, submap, submap_from_camera, timestamp: Timestamp(0) }, dissimilarity }
    }

    #[test]
    fn proposals_are_the_likeliest_that_are_apart() {
        let own = RelocaliserSettings { candidates: 4, ..Default::default() };
        let of = |candidates: &[Candidate], own: &RelocaliserSettings| {
            let all = candidates.iter().map(|candidate| Proposal::at(*candidate)).collect();
            apart(all, own).iter().map(|proposal| proposal.candidate.keyframe.id).collect::<Vec<_>>()
        };
        let candidates = [
            candidate(0, 0, 0.0, 0.3),
            // Likelier, and near the first.
            candidate(1, 0, 0.2, 0.2),
            // As far from there in another submap; and as likely as the first, but further than that.
            candidate(2, 1, 0.2, 0.9),
            candidate(3, 0, 1.0, 0.3),
            candidate(4, 0, -1.0, 0.3),
            candidate(5, 0, 5.0, 0.95),
        ];
        assert_eq!(of(&candidates, &own), [1, 3, 4, 2]);
        assert_eq!(of(&candidates, &RelocaliserSettings { apart_m: 0.0, ..own.clone() }), [1, 0, 3, 4]);
        assert_eq!(of(&candidates, &RelocaliserSettings { candidates: 1, ..own.clone() }), [1]);
        assert_eq!(of(&[], &own), [0_u32; 0]);
        // What is turned away is another place.
        let turned = |rad| {
            let seen = Proposal::seen_from(candidates[1], &Se3::exp([0.0, 0.0, 0.0, 0.0, rad, 0.0]));
            apart(vec![Proposal::at(candidates[1]), seen], &own).len()
        };
        assert_eq!((turned(0.2), turned(0.4)), (1, 2));
    }

    #[test]
    fn a_view_from_elsewhere_says_where_the_frame_was_taken() {
        // From a metre ahead, the frame would look as the keyframe does: it was taken a metre behind the keyframe.
        let ahead = Se3::exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let proposal = Proposal::seen_from(candidate(0, 0, 3.0, 0.0), &ahead);
        assert!(is_near(&proposal.submap_from_camera, &Se3::exp([3.0, 0.0, -1.0, 0.0, 0.0, 0.0]), 1e-12, 1e-7));
    }

    #[test]
    fn of_places_that_are_the_same_the_best_is_kept() {
        let own = RelocaliserSettings::default();
        let place = |error, submap, x| Place::new(error, Proposal::at(candidate(0, submap, x, 0.0)));
        let errors = |places| distinct(places, &own).iter().map(|place| place.error).collect::<Vec<_>>();
        let mut places = vec![place(3.0, 0, 0.0), place(1.0, 0, 0.04), place(2.0, 1, 0.0), place(4.0, 0, 0.2)];
        places[0].followed_up = true;
        // The first was looked at already, and the second is the same.
        assert_eq!(errors(places), [2.0, 3.0, 4.0]);
        assert_eq!(errors(vec![place(3.0, 0, 0.0), place(1.0, 0, 0.04), place(2.0, 1, 0.0)]), [1.0, 2.0]);
    }
}
