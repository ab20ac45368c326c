//! The objective as the device evaluates it: a view against the model that was cast from the map.

use itm_core::Se3;
use itm_gpu::evaluate::{ColourTerm, Compared, Evaluator};
use itm_gpu::photometric::PointList;
use itm_gpu::{RaycastImage, View};

use super::{Evaluation, Guess, Objective, Request};

/// The camera's motion from the moment of its depth image to that of its colour image, if it went on as from the pose
/// before, by a share of that way.
pub(crate) fn colour_offset(before: &Option<Se3>, world_from_camera: &Se3, lead: f64) -> Se3 {
    match before {
        Some(before) if lead != 0.0 => Se3::exp((before.inverse() * *world_from_camera).log().map(|v| lead * v)),
        _ => Se3::IDENTITY,
    }
}

/// The GPU's sums for a view against the model.
pub(crate) struct ModelObjective<'a> {
    pub(crate) evaluator: &'a mut Evaluator,
    pub(crate) view: &'a View,
    pub(crate) model: &'a RaycastImage,
    pub(crate) lists: [Option<&'a PointList>; 2],
    pub(crate) world_from_model: Se3,
    /// The pose before.
    pub(crate) before: Option<Se3>,
    /// See [`Motion::colour_lead`].
    pub(crate) colour_lead: f64,
    pub(crate) depth_from_colour: Se3,
}

impl Objective for ModelObjective<'_> {
    fn pivot(&self) -> glam::DVec3 {
        // As the shader sees it: in single precision.
        self.world_from_model.translation.as_vec3().as_dvec3()
    }

    fn evaluate(&mut self, guess: &Guess, request: &Request) -> Result<Evaluation, itm_gpu::Error> {
        let pose = &guess.world_from_camera;
        let offset = colour_offset(&self.before, pose, self.colour_lead);
        let world_from_colour = *pose * offset * self.depth_from_colour;
        let terms: [Option<ColourTerm<'_>>; 2] = std::array::from_fn(|i| {
            let mut term = request.colour[i]?;
            (term.gain, term.offset) = (guess.exposure[i].gain as f32, guess.exposure[i].offset as f32);
            Some(ColourTerm { list: self.lists[i]?, world_from_colour, term })
        });
        let compared = Compared {
            view: self.view,
            level: request.level,
            model: self.model,
            world_from_model: self.world_from_model,
        };
        let terms = terms.each_ref().map(Option::as_ref);
        let (depth, mut colour) = self.evaluator.evaluate(&compared, pose, request.depth.as_ref(), terms)?;
        // A step of the depth camera's moves the colour camera by as much more as it is ahead.
        let further = 1.0 + self.colour_lead;
        for sums in colour.iter_mut().flatten() {
            for i in 0..6 {
                sums.gradient[i] *= further;
                for j in 0..6 {
                    sums.hessian[i][j] *= further * further;
                }
                for j in 6..8 {
                    sums.hessian[i][j] *= further;
                    sums.hessian[j][i] *= further;
                }
            }
        }
        Ok(Evaluation { depth, colour })
    }

    fn evaluate_all(&mut self, guesses: &[Guess], request: &Request) -> Result<Vec<Evaluation>, itm_gpu::Error> {
        let (Some(term), [None, None]) = (&request.depth, &request.colour) else {
            return guesses.iter().map(|guess| self.evaluate(guess, request)).collect();
        };
        let compared = Compared {
            view: self.view,
            level: request.level,
            model: self.model,
            world_from_model: self.world_from_model,
        };
        let poses: Vec<Se3> = guesses.iter().map(|guess| guess.world_from_camera).collect();
        let sums = self.evaluator.evaluate_at(&compared, &poses, term)?;
        Ok(sums.into_iter().map(|depth| Evaluation { depth: Some(depth), colour: [None; 2] }).collect())
    }
}
