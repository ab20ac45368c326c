//! The submaps of a map: where they lie in the world, what is known of their places relative to each other, and the frames'
//! poses in them (Kähler et al. 2016, *Real-Time Large-Scale Dense 3D Reconstruction with Loop Closure*).
//!
//! Poses are optimised on a thread of its own. Its result is taken over a fixed number of frames later, waited for where it is
//! late, so that a recording gives the same map each time.

mod check;

use std::collections::{BTreeMap, BTreeSet};
use std::thread::JoinHandle;

use glam::DVec3;
use itm_core::{Intrinsics, Se3, StampedPose, SubmapSettings, Timestamp, Trajectory};
use itm_graph::{Edge, NodeId, Options, PoseGraph, information};
use itm_io::map_file::{SubmapPose, SubmapState};
use serde::{Deserialize, Serialize};

use crate::happening::{Happening, Optimised};
use crate::link::{Link, Observation, together};
pub(crate) use check::{LeftOut, check_pose};

/// How well a submap's place is known before it is measured, as standard deviations: it begins at the camera's pose in the one
/// before.
const AT_BIRTH: [f64; 2] = [0.02, 0.01];

/// A rigid part of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Submap {
    /// Where it lies in the world.
    pub world_from_submap: Se3,
    /// Whether the camera is tracked in it.
    pub state: SubmapState,
    /// The submap that it began in, and where.
    parent: Option<(u16, Se3)>,
    /// Centres of some blocks that its first frame saw, in metres.
    central: Vec<[f32; 3]>,
    /// How far the camera had gone when it was last tracked in this submap, in metres.
    left_at_m: f64,
}

/// A pose between two submaps that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SubmapLink {
    /// The one submap.
    pub from: u16,
    /// The other.
    pub to: u16,
    /// The pose of the other in the one.
    pub from_from_to: Se3,
    /// Whether the camera came back to get it.
    pub closure: bool,
    /// Frames that measured it, of the last ones.
    pub frames: usize,
}

/// Where a frame's camera is in a submap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PoseIn {
    pub(crate) submap: u16,
    pub(crate) submap_from_camera: Se3,
    /// How much it counts: the share of the frame's pixels that agree with the submap.
    pub(crate) weight: f64,
}

/// Where a frame's camera is in all submaps that it was tracked in.
#[derive(Clone, Debug)]
struct FramePoses {
    timestamp: Timestamp,
    primary: PoseIn,
    beside: Vec<PoseIn>,
}

impl FramePoses {
    /// Their mean in the world, by weight. Each submap is bent in its own way, so that it errs by less than any of them. One
    /// that is further from the primary's than frames of a link may be from each other does not count.
    fn mean(&self, world_from: impl Fn(u16) -> Se3, settings: &SubmapSettings) -> Se3 {
        let first = world_from(self.primary.submap) * self.primary.submap_from_camera;
        let length = |twist: &[f64; 6]| twist.iter().map(|v| v * v).sum::<f64>().sqrt();
        let (mut sum, mut weights) = ([0.0; 6], self.primary.weight);
        for PoseIn { submap, submap_from_camera, weight } in &self.beside {
            // They are so near each other that the mean of their twists is that of the poses.
            let off = (first.inverse() * world_from(*submap) * *submap_from_camera).log();
            if length(&off) <= settings.link_huber {
                sum.iter_mut().zip(off).for_each(|(sum, off)| *sum += weight * off);
                weights += weight;
            }
        }
        if weights > self.primary.weight { first * Se3::exp(sum.map(|v| v / weights)) } else { first }
    }
}

/// All submaps.
#[derive(Debug)]
pub(crate) struct Atlas {
    pub(crate) settings: SubmapSettings,
    pub(crate) submaps: Vec<Submap>,
    /// By their submaps, the lower number first, and whether the camera came back to get them.
    links: BTreeMap<(u16, u16, bool), Link>,
    /// The frames that have a pose.
    frames: Vec<FramePoses>,
    /// How far the camera has gone, in metres.
    way_m: f64,
    /// Links measured since the poses were last optimised.
    unused: u32,
    running: Option<Running>,
    /// Submaps whose blocks are all gone: the camera is not looked for there.
    without_blocks: BTreeSet<u16>,
}

/// An optimisation that was begun.
#[derive(Debug)]
struct Running {
    /// Its result is taken over at this frame.
    due: u64,
    result: RunResult,
}

/// All submaps' poses, and what was done; `None` where it failed.
type Solved = Option<(Vec<Se3>, Optimised)>;

#[derive(Debug)]
enum RunResult {
    Coming(JoinHandle<Solved>),
    Here(Solved),
}

impl RunResult {
    fn begin(mut graph: PoseGraph) -> Self {
        Self::Coming(std::thread::spawn(move || match graph.optimise(&Options::default()) {
            Ok(report) => {
                let optimised = Optimised {
                    submaps: graph.nodes().len(),
                    links: graph.edges().len(),
                    moved_m: 0.0,
                    cost: [report.initial_cost, report.final_cost],
                    doubted: report.edges.iter().filter(|edge| edge.weight < 0.1).count(),
                };
                Some((graph.nodes().iter().map(|node| node.world_from_node).collect(), optimised))
            }
            Err(error) => {
                tracing::warn!("the submaps' poses were not optimised: {error}");
                None
            }
        }))
    }

    fn wait(self) -> Solved {
        match self {
            Self::Here(solved) => solved,
            Self::Coming(thread) => thread.join().unwrap_or_else(|_panicked| {
                tracing::error!("the optimisation of the submaps' poses stopped");
                None
            }),
        }
    }
}

/// An [`Atlas`] as it is saved.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct AtlasState {
    way_m: f64,
    unused: u32,
    /// When the result of an optimisation is due, and what it is.
    running: Option<(u64, Solved)>,
    submaps: Vec<Submap>,
    links: Vec<Link>,
    frames: Vec<(i64, u16, Se3)>,
    /// Of each frame how much its pose counts, and its poses in other submaps; maps of earlier versions have none.
    #[serde(default)]
    beside: Vec<(f64, Vec<PoseIn>)>,
    /// The poses in the world as they were found.
    live: Vec<Se3>,
}

impl Atlas {
    /// One submap, at the world's origin.
    pub(crate) fn new(settings: &SubmapSettings) -> Self {
        let first = Submap {
            world_from_submap: Se3::IDENTITY,
            state: SubmapState::Primary,
            parent: None,
            central: Vec::new(),
            left_at_m: 0.0,
        };
        Self {
            settings: settings.clone(),
            submaps: vec![first],
            links: BTreeMap::new(),
            frames: Vec::new(),
            way_m: 0.0,
            unused: 0,
            running: None,
            without_blocks: BTreeSet::new(),
        }
    }

    pub(crate) fn submap(&self, number: u16) -> &Submap {
        &self.submaps[usize::from(number)]
    }

    pub(crate) fn world_from(&self, number: u16) -> Se3 {
        self.submap(number).world_from_submap
    }

    /// The number of the next submap, unless there are as many as there can be.
    pub(crate) fn next_number(&self) -> Option<u16> {
        // 65535 is the key of blocks that are not in use.
        u16::try_from(self.submaps.len()).ok().filter(|number| *number < u16::MAX)
    }

    /// Begins a submap at a camera's pose in another one.
    pub(crate) fn begin(&mut self, parent: u16, parent_from_camera: &Se3) {
        self.submaps.push(Submap {
            world_from_submap: self.world_from(parent) * *parent_from_camera,
            state: SubmapState::Passive,
            parent: Some((parent, *parent_from_camera)),
            central: Vec::new(),
            left_at_m: self.way_m,
        });
    }

    /// Sets what its first frame saw: centres of blocks, of which as many as the settings say are kept, evenly.
    pub(crate) fn set_central(&mut self, number: u16, blocks: &[DVec3]) {
        let most = self.settings.central_blocks as usize;
        let kept = blocks.len().min(most);
        let central = (0..kept).map(|i| blocks[i * blocks.len() / kept].as_vec3().to_array());
        self.submaps[usize::from(number)].central = central.collect();
    }

    pub(crate) fn has_central(&self, number: u16) -> bool {
        !self.submap(number).central.is_empty()
    }

    /// The share of a submap's central part that a camera has in view.
    pub(crate) fn share_in_view(
        &self,
        number: u16,
        camera: &Intrinsics,
        submap_from_camera: &Se3,
        max_depth_m: f64,
    ) -> f64 {
        let central = &self.submap(number).central;
        let inside = |centre: &&[f32; 3]| {
            sees(camera, submap_from_camera, max_depth_m, DVec3::from_array(centre.map(f64::from)))
        };
        central.iter().filter(inside).count() as f64 / central.len().max(1) as f64
    }

    /// Takes a frame's pose in the primary submap in, and those in the others that it was tracked in.
    pub(crate) fn moved_to(&mut self, timestamp: Timestamp, primary: PoseIn, beside: Vec<PoseIn>) {
        // In the order of the live trajectory: where a recording is gone back in, frames do not come last.
        let at = self.frames.partition_point(|frame| frame.timestamp <= timestamp);
        if let Some(FramePoses { primary: before, .. }) = at.checked_sub(1).map(|before| &self.frames[before])
            && before.submap == primary.submap
        {
            let [before, now] = [before, &primary].map(|pose| pose.submap_from_camera.translation);
            self.way_m += before.distance(now);
        }
        self.submaps[usize::from(primary.submap)].left_at_m = self.way_m;
        self.frames.insert(at, FramePoses { timestamp, primary, beside });
    }

    pub(crate) fn set_state(&mut self, number: u16, state: SubmapState) {
        let submap = &mut self.submaps[usize::from(number)];
        if submap.state != SubmapState::Passive {
            submap.left_at_m = self.way_m;
        }
        submap.state = state;
    }

    /// How far a closure may move the camera, in metres.
    pub(crate) fn drift_allowed_m(&self, to: u16) -> f64 {
        self.settings.max_drift_m + self.settings.max_drift * (self.way_m - self.submap(to).left_at_m)
    }

    /// Takes in what a frame says of the pose between two submaps. The link, where this has measured it for the first time.
    pub(crate) fn observe(&mut self, pair: [u16; 2], observation: Observation) -> Option<&Link> {
        let [from, to] = pair;
        // What was got by coming back stays apart from what was got in passing: either may be wrong.
        let closure = self.links.contains_key(&(from, to, true));
        let link = self.links.entry((from, to, closure)).or_insert_with(|| Link::new(pair, closure));
        let first = link.observe(observation, &self.settings);
        if !first {
            return None;
        }
        self.unused = self.unused.saturating_add(link.measured(&self.settings).is_some().into());
        self.links.get(&(from, to, closure))
    }

    /// Takes a closure's link in, in place of an earlier closure's.
    pub(crate) fn close(&mut self, link: Link) {
        self.unused = self.settings.optimise_every;
        self.links.insert(link.key(), link);
    }

    /// The links that were measured.
    pub(crate) fn links(&self) -> impl Iterator<Item = SubmapLink> {
        self.links.values().filter_map(|link| {
            let (from_from_to, _) = link.measured(&self.settings)?;
            let Link { from, to, closure, .. } = *link;
            Some(SubmapLink { from, to, from_from_to, closure, frames: link.frames() })
        })
    }

    pub(crate) fn is_measured(&self, a: u16, b: u16) -> bool {
        let measured = |closure| {
            self.links.get(&(a.min(b), a.max(b), closure)).is_some_and(|link| link.measured(&self.settings).is_some())
        };
        measured(false) || measured(true)
    }

    /// Takes over the result that is due at a frame, and begins another optimisation where there is something new.
    pub(crate) fn optimise(&mut self, frame: u64) -> Option<Happening> {
        let due = self.running.as_ref().is_some_and(|running| running.due <= frame);
        let happening = if due { self.take_over() } else { None };
        if self.running.is_none() && self.unused >= self.settings.optimise_every {
            self.unused = 0;
            let due = frame + u64::from(self.settings.optimise_delay);
            self.running = self.graph().map(|graph| Running { due, result: RunResult::begin(graph) }).map_or_else(
                |error| {
                    tracing::warn!("the submaps' poses cannot be optimised: {error}");
                    None
                },
                Some,
            );
        }
        happening
    }

    /// Optimises with all that is known, at the end of a run.
    pub(crate) fn finish(&mut self) -> Option<Happening> {
        let _replaced = self.take_over();
        self.unused = self.settings.optimise_every;
        let _begun = self.optimise(0);
        self.take_over()
    }

    /// Waits for the optimisation that was begun, and takes its result over.
    fn take_over(&mut self) -> Option<Happening> {
        let (poses, mut optimised) = self.running.take()?.result.wait()?;
        // Submaps that began meanwhile move with the ones that they began in.
        for number in 0..self.submaps.len() {
            let pose = match poses.get(number) {
                Some(pose) => *pose,
                None => {
                    let Some((parent, pose)) = self.submaps[number].parent else { continue };
                    self.world_from(parent) * pose
                }
            };
            let before = std::mem::replace(&mut self.submaps[number].world_from_submap, pose);
            optimised.moved_m = optimised.moved_m.max(pose.translation.distance(before.translation));
        }
        Some(Happening::Optimised(optimised))
    }

    /// The graph of the submaps' poses: measured links, and between a submap and that in which it began, where that is not
    /// measured, the camera's pose then.
    pub(crate) fn graph(&self) -> Result<PoseGraph, itm_graph::Error> {
        let mut graph = PoseGraph::new();
        for (number, submap) in (0..).zip(&self.submaps) {
            graph.add_node(NodeId(number), submap.world_from_submap)?;
        }
        for link in self.links.values() {
            let Some(mut known) = link.measured(&self.settings) else { continue };
            let beside = self.links.get(&(link.from, link.to, !link.closure)).and_then(|l| l.measured(&self.settings));
            if let Some(beside) = beside {
                if link.closure {
                    continue;
                }
                known = together(known, beside);
            }
            let (pose, information) = known;
            let (from, to) = (NodeId(link.from.into()), NodeId(link.to.into()));
            let edge = if link.closure { Edge::closure } else { Edge::sequential };
            graph.add_edge(edge(from, to, pose, information))?;
        }
        for (number, submap) in (0_u16..).zip(&self.submaps) {
            let Some((parent, pose)) = submap.parent else { continue };
            if !self.is_measured(parent, number) {
                let known = information(AT_BIRTH[0], AT_BIRTH[1]);
                graph.add_edge(Edge::sequential(NodeId(parent.into()), NodeId(number.into()), pose, known))?;
            }
        }
        Ok(graph)
    }

    /// The frames' poses as the submaps lie now.
    pub(crate) fn trajectory(&self) -> Trajectory {
        self.trajectory_with(|submap| self.world_from(submap))
    }

    /// The frames' poses where the submaps lie otherwise.
    pub(crate) fn trajectory_with(&self, world_from: impl Fn(u16) -> Se3) -> Trajectory {
        let pose = |frame: &FramePoses| StampedPose {
            timestamp: frame.timestamp,
            world_from_camera: frame.mean(&world_from, &self.settings),
        };
        self.frames.iter().map(pose).collect()
    }

    /// Where each submap lies once all that is known is taken over, or as they lie where they are not to move; nothing is changed
    /// by it.
    pub(crate) fn settled(&self, moves: bool) -> Vec<SubmapPose> {
        let graph = if moves { self.graph().ok() } else { None };
        let poses = graph.and_then(|graph| RunResult::begin(graph).wait()).map(|(poses, _)| poses).unwrap_or_default();
        let submap = |(number, submap): (usize, &Submap)| SubmapPose {
            submap: number as u16,
            world_from_submap: poses.get(number).copied().unwrap_or(submap.world_from_submap),
            state: submap.state,
        };
        self.submaps.iter().enumerate().map(submap).collect()
    }

    /// Waits for what runs. Its result is still taken over at its frame.
    pub(crate) fn state(&mut self, live: &Trajectory) -> AtlasState {
        let running = self.running.take().map(|running| (running.due, running.result.wait()));
        self.running = running.clone().map(|(due, solved)| Running { due, result: RunResult::Here(solved) });
        AtlasState {
            way_m: self.way_m,
            unused: self.unused,
            running,
            submaps: self.submaps.clone(),
            links: self.links.values().cloned().collect(),
            frames: (self.frames.iter())
                .map(|frame| (frame.timestamp.0, frame.primary.submap, frame.primary.submap_from_camera))
                .collect(),
            beside: self.frames.iter().map(|frame| (frame.primary.weight, frame.beside.clone())).collect(),
            live: live.poses().iter().map(|pose| pose.world_from_camera).collect(),
        }
    }

    /// With the poses in the world as they were found.
    pub(crate) fn from_state(settings: &SubmapSettings, state: AtlasState) -> (Self, Trajectory) {
        let AtlasState { way_m, unused, running, submaps, links, frames, beside, live } = state;
        let found = frames.iter().zip(live);
        let live = found.map(|((time, ..), pose)| StampedPose { timestamp: Timestamp(*time), world_from_camera: pose });
        let live = live.collect();
        let atlas = Self {
            settings: settings.clone(),
            submaps,
            links: links.into_iter().map(|link| (link.key(), link)).collect(),
            frames: frames
                .into_iter()
                .zip(beside.into_iter().chain(std::iter::repeat((1.0, Vec::new()))))
                .map(|((time, submap, submap_from_camera), (weight, beside))| FramePoses {
                    timestamp: Timestamp(time),
                    primary: PoseIn { submap, submap_from_camera, weight },
                    beside,
                })
                .collect(),
            way_m,
            unused,
            running: running.map(|(due, solved)| Running { due, result: RunResult::Here(solved) }),
            without_blocks: BTreeSet::new(),
        };
        (atlas, live)
    }

    /// For a new session in the same submaps, none of which the camera is known to be in.
    pub(crate) fn afresh(mut self) -> Self {
        self.frames.clear();
        self.running = None;
        for submap in &mut self.submaps {
            submap.state = SubmapState::Passive;
            submap.left_at_m = self.way_m;
        }
        self
    }

    /// Takes note of which submaps have blocks; those that have none any more. The one that frames are fused into counts as
    /// having some.
    pub(crate) fn note_blocks(&mut self, there: &BTreeSet<u16>, primary: Option<u16>) -> Vec<u16> {
        let gone = |number: &u16| !there.contains(number) && Some(*number) != primary;
        let without: BTreeSet<u16> = (0..self.submaps.len() as u16).filter(gone).collect();
        let new = without.difference(&self.without_blocks).copied().collect();
        self.without_blocks = without;
        new
    }

    pub(crate) fn has_blocks(&self, number: u16) -> bool {
        !self.without_blocks.contains(&number)
    }

    /// The submap that a camera (world frame) sees most of the middle of.
    pub(crate) fn seen_best_from(&self, camera: &Intrinsics, world_from_camera: &Se3, max_depth_m: f64) -> u16 {
        let share = |number: u16| {
            let pose = self.world_from(number).inverse() * *world_from_camera;
            self.share_in_view(number, camera, &pose, max_depth_m)
        };
        // Of equal ones the first.
        let there = (0..self.submaps.len() as u16).filter(|number| self.has_blocks(*number));
        there.rev().max_by(|a, b| share(*a).total_cmp(&share(*b))).unwrap_or(0)
    }
}

/// Whether a camera has a point in view, were nothing in between.
pub(crate) fn sees(camera: &Intrinsics, world_from_camera: &Se3, max_depth_m: f64, point: DVec3) -> bool {
    let p = world_from_camera.inverse().transform_point(point);
    let limits = DVec3::new(f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5, max_depth_m);
    p.z <= limits.z
        && camera
            .project(p)
            .is_some_and(|pixel| pixel.min_element() >= -0.5 && pixel.x <= limits.x && pixel.y <= limits.y)
}
