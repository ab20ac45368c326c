//! Which topic is which: as asked for, or by what their messages are.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use super::container::Topic;
use super::messages::Purpose;
use super::pixels::{Content, Sample};
use super::transforms::frame_name;
use crate::Error;

/// The topics of an MCAP recording to read, where its messages do not tell, or tell of several.
///
/// As text: `depth=/camera/depth/image_raw,color=/camera/color/image_raw`, with the names `depth`, `color` (or `colour`),
/// `depth_info`, `color_info`, `pose` and `imu`. `none` in place of a topic means that there shall be none, which `color`,
/// `pose` and `imu` can do without.
///
/// ```
/// use itm_io::recording::Topics;
///
/// let topics: Topics = "depth=/stereo/depth,color=none".parse()?;
/// assert_eq!(topics.depth.as_deref(), Some("/stereo/depth"));
/// assert!("deep=/stereo/depth".parse::<Topics>().is_err());
/// # Ok::<(), itm_io::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topics {
    /// Depth images.
    pub depth: Option<String>,
    /// Colour images.
    pub colour: Option<String>,
    /// The depth camera's calibration.
    pub depth_info: Option<String>,
    /// The colour camera's calibration.
    pub colour_info: Option<String>,
    /// Poses: of the camera, of what it is fixed to, or a tree of frames (`/tf`).
    pub pose: Option<String>,
    /// A gyroscope's readings.
    pub imu: Option<String>,
}

/// In place of a topic: none of them.
const NONE: &str = "none";

impl Topics {
    /// Whether nothing is asked for.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

impl FromStr for Topics {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let mut topics = Self::default();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let wrong = || Error::TopicChoice {
                given: part.into(),
                expected: "NAME=TOPIC with depth, color, depth_info, color_info, pose or imu as NAME, each once",
            };
            let (name, topic) = part.split_once('=').ok_or_else(wrong)?;
            let (name, topic) = (name.trim(), topic.trim());
            let place = match name {
                "depth" => &mut topics.depth,
                "color" | "colour" => &mut topics.colour,
                "depth_info" => &mut topics.depth_info,
                "color_info" | "colour_info" => &mut topics.colour_info,
                "pose" => &mut topics.pose,
                "imu" => &mut topics.imu,
                _ => return Err(wrong()),
            };
            let can_do_without = matches!(name, "color" | "colour" | "pose" | "imu");
            if topic.is_empty() || (topic == NONE && !can_do_without) || place.is_some() {
                return Err(wrong());
            }
            *place = Some(topic.into());
        }
        Ok(topics)
    }
}

/// A topic of images that could be looked at.
pub(super) struct Candidate<'a> {
    /// Among all topics.
    pub(super) index: usize,
    pub(super) topic: &'a Topic,
    pub(super) sample: Sample,
}

impl fmt::Display for Candidate<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Sample { encoding, size: (width, height), .. } = &self.sample;
        let Topic { name, schema, count, .. } = self.topic;
        write!(f, "{name}: {schema}, {encoding}, {width}x{height}, {count} messages")
    }
}

impl Candidate<'_> {
    /// The topic without what image_transport adds for a compressed copy: the same for all copies of a camera's images.
    fn camera(&self) -> &str {
        let name = self.topic.name.as_str();
        ["/compressedDepth", "/compressed"].into_iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name)
    }

    fn is_compressed(&self) -> bool {
        self.topic.kind.is_some_and(super::messages::Kind::is_compressed)
    }

    fn name_has(&self, words: &[&str]) -> bool {
        let name = self.topic.name.to_lowercase();
        words.iter().any(|word| name.contains(word))
    }

    /// By their names, rectified images are those of a pinhole camera.
    pub(super) fn is_rectified(&self) -> bool {
        self.camera().rsplit('/').next().is_some_and(|last| last.contains("rect"))
    }
}

/// What is chosen from.
pub(super) struct Choice<'a> {
    pub(super) path: &'a Path,
    pub(super) topics: &'a [Topic],
    pub(super) wanted: &'a Topics,
}

const INFRARED: [&str; 3] = ["infra", "/ir/", "ir_image"];

impl<'a> Choice<'a> {
    fn error(&self, problem: impl Into<String>, candidates: Vec<String>, advice: impl Into<String>) -> Error {
        Error::Topics { path: self.path.to_path_buf(), problem: problem.into(), candidates, advice: advice.into() }
    }

    fn list(&self, purpose: Purpose) -> Vec<String> {
        self.topics.iter().filter(|topic| topic.is_for(purpose)).map(describe).collect()
    }

    /// A topic that was asked for by name.
    fn named(&self, name: &str, role: &str, purposes: &[Purpose]) -> Result<usize, Error> {
        let fits = |topic: &Topic| purposes.iter().any(|&purpose| topic.is_for(purpose));
        let found = self.topics.iter().position(|topic| topic.name == name && fits(topic));
        found.ok_or_else(|| {
            let problem = match self.topics.iter().find(|topic| topic.name == name) {
                Some(topic) => format!("the topic '{name}' is of {} and cannot be {role}", describe_schema(topic)),
                None => format!("there is no topic '{name}' for {role}"),
            };
            let candidates = self.topics.iter().filter(|topic| fits(topic)).map(describe).collect();
            self.error(problem, candidates, format!("choose with --topics {role}=TOPIC"))
        })
    }

    /// The topic of depth images.
    pub(super) fn depth(&self, images: &'a [Candidate<'a>]) -> Result<&'a Candidate<'a>, Error> {
        let all = || images.iter().map(ToString::to_string).collect::<Vec<_>>();
        if let Some(name) = &self.wanted.depth {
            let index = self.named(name, "depth", &[Purpose::Image])?;
            return images
                .iter()
                .find(|image| image.index == index && image.sample.content == Content::Depth)
                .ok_or_else(|| {
                    let problem = format!("the images of '{name}' are not depth");
                    self.error(problem, all(), "depth has the encoding 16UC1, mono16 or 32FC1, raw or compressed")
                });
        }
        let fits: Vec<_> = images.iter().filter(|image| image.sample.content == Content::Depth).collect();
        let by_name = narrowed(fits.clone(), |image| image.name_has(&["depth"]));
        let by_name = narrowed(by_name, |image| !image.name_has(&INFRARED));
        match one_per_camera(by_name).as_slice() {
            [] if self.topics.iter().any(|topic| topic.encoding == "ros1") => Err(self.error(
                "its messages are those of ROS 1 (encoding ros1), which are not read",
                Vec::new(),
                "convert it to ROS 2 first, where messages are in CDR, as the program rosbags-convert does",
            )),
            [] => {
                let others: Vec<String> = self.topics.iter().map(describe).collect();
                let advice = "depth has the encoding 16UC1, mono16 or 32FC1 in sensor_msgs/msg/Image or CompressedImage \
                     (CDR), foxglove.RawImage or CompressedImage (protobuf)";
                let problem = if self.topics.is_empty() {
                    "it has no topics at all"
                } else {
                    "it has no depth images; its topics are"
                };
                Err(self.error(problem, others, advice))
            }
            [one] => Ok(*one),
            several => {
                let candidates = several.iter().map(ToString::to_string).collect();
                Err(self.error("several topics have depth images", candidates, "choose with --topics depth=TOPIC"))
            }
        }
    }

    /// The topic of colour images that belongs to one of depth.
    pub(super) fn colour(
        &self,
        images: &'a [Candidate<'a>],
        depth: &Candidate<'_>,
    ) -> Result<Option<&'a Candidate<'a>>, Error> {
        match self.wanted.colour.as_deref() {
            Some(NONE) => return Ok(None),
            Some(name) => {
                let index = self.named(name, "color", &[Purpose::Image])?;
                let fits = |image: &&Candidate<'_>| image.index == index && image.sample.content == Content::Colour;
                return images.iter().find(fits).map(Some).ok_or_else(|| {
                    let all = images.iter().map(ToString::to_string).collect();
                    let problem = format!("the images of '{name}' are not 8-bit colour or grey");
                    self.error(problem, all, "choose with --topics color=TOPIC, or color=none")
                });
            }
            None => {}
        }
        let fits: Vec<_> = images.iter().filter(|image| image.sample.content == Content::Colour).collect();
        let fits = narrowed(fits, |image| image.name_has(&["color", "colour", "rgb"]));
        let fits = narrowed(fits, |image| !image.name_has(&INFRARED));
        let fits = narrowed(fits, |image| !image.name_has(&["depth"]) || depth.camera() == image.camera());
        // The one of the same camera, where there are several cameras.
        let shared = |image: &Candidate<'_>| {
            let parts = image.topic.name.split('/').zip(depth.topic.name.split('/'));
            parts.take_while(|(a, b)| a == b).count()
        };
        let most = fits.iter().map(|image| shared(image)).max().unwrap_or(0);
        match one_per_camera(narrowed(fits, |image| shared(image) == most)).as_slice() {
            [] => Ok(None),
            [one] => Ok(Some(*one)),
            several => {
                let candidates = several.iter().map(ToString::to_string).collect();
                let advice = "choose with --topics color=TOPIC, or color=none";
                Err(self.error("several topics have colour images", candidates, advice))
            }
        }
    }

    /// The topic of the calibration of a camera whose images are those of a topic.
    pub(super) fn info(&self, image: &Candidate<'_>, role: &str, wanted: Option<&str>) -> Result<usize, Error> {
        if let Some(name) = wanted {
            return self.named(name, role, &[Purpose::Camera]);
        }
        let parent = |name: &str| name.rsplit_once('/').map_or(String::new(), |(parent, _)| parent.to_string());
        let beside = parent(image.camera());
        let all: Vec<usize> = (0..self.topics.len()).filter(|&at| self.topics[at].is_for(Purpose::Camera)).collect();
        let siblings: Vec<usize> = all.iter().copied().filter(|&at| parent(&self.topics[at].name) == beside).collect();
        if let [one] = siblings[..] {
            return Ok(one);
        }
        let frame = frame_name(&image.sample.frame);
        let of_frame = |at: &usize| {
            let camera = self.topics[*at].camera.as_ref();
            camera.is_some_and(|camera| {
                frame_name(&camera.frame) == frame && camera.camera(image.sample.size, false).is_ok()
            })
        };
        let same_frame: Vec<usize> = all.iter().copied().filter(of_frame).collect();
        if let [one] = same_frame[..] {
            return Ok(one);
        }
        let problem = format!(
            "no topic, or more than one, is obviously the calibration of the camera of '{}' (frame '{}')",
            image.topic.name, image.sample.frame
        );
        let advice = format!("choose with --topics {role}=TOPIC, or name a file with --calibration");
        Err(self.error(problem, self.list(Purpose::Camera), advice))
    }

    /// The topic of poses, or of a tree in which something moves the camera (`tree_moves`); with why not, where several
    /// would do.
    pub(super) fn pose(&self, tree_moves: bool) -> Result<Option<PoseSource>, Error> {
        match self.wanted.pose.as_deref() {
            Some(NONE) => return Ok(None),
            Some(name) => {
                let index = self.named(name, "pose", &[Purpose::Pose, Purpose::Transforms])?;
                let is_tree = self.topics[index].is_for(Purpose::Transforms);
                return Ok(Some(if is_tree { PoseSource::Tree } else { PoseSource::Topic(index) }));
            }
            None => {}
        }
        let poses: Vec<usize> = (0..self.topics.len())
            .filter(|&at| self.topics[at].is_for(Purpose::Pose) && !self.topics[at].transforms.is_empty())
            .collect();
        let is_truth = |at: &usize| {
            let name = self.topics[*at].name.to_lowercase();
            ["ground_truth", "groundtruth", "mocap", "vicon", "optitrack"].iter().any(|word| name.contains(word))
        };
        let true_ones: Vec<usize> = poses.iter().copied().filter(is_truth).collect();
        // What odometry says is also sent as a part of the tree.
        let all_odometry = poses.iter().all(|&at| self.topics[at].schema.ends_with("Odometry"));
        match (true_ones.as_slice(), poses.as_slice(), tree_moves) {
            (&[one], _, _) | (_, &[one], false) => Ok(Some(PoseSource::Topic(one))),
            (_, [], true) => Ok(Some(PoseSource::Tree)),
            (_, [], false) => Ok(None),
            (_, _, true) if all_odometry => Ok(Some(PoseSource::Tree)),
            _ => {
                let trees = self.topics.iter().filter(|topic| tree_moves && topic.is_for(Purpose::Transforms));
                let several: Vec<String> =
                    poses.iter().map(|&at| &self.topics[at]).chain(trees).map(describe).collect();
                tracing::warn!(
                    "'{}': no true poses are read, as several topics have some ({}); choose with --topics pose=TOPIC",
                    self.path.display(),
                    several.join("; ")
                );
                Ok(None)
            }
        }
    }

    /// The topic of a gyroscope's readings.
    pub(super) fn imu(&self) -> Result<Option<usize>, Error> {
        match self.wanted.imu.as_deref() {
            Some(NONE) => return Ok(None),
            Some(name) => return self.named(name, "imu", &[Purpose::Inertial]).map(Some),
            None => {}
        }
        let all: Vec<usize> = (0..self.topics.len())
            .filter(|&at| self.topics[at].is_for(Purpose::Inertial) && !self.topics[at].inertial.is_empty())
            .collect();
        // Some drivers send each sensor's readings as messages of their own that have room for both.
        let all = narrowed(all, |&at| self.topics[at].name.contains("gyro"));
        let all = narrowed(all, |&at| !self.topics[at].name.contains("accel"));
        match all[..] {
            [] => Ok(None),
            [one] => Ok(Some(one)),
            _ => {
                let several: Vec<String> = all.iter().map(|&at| describe(&self.topics[at])).collect();
                tracing::warn!(
                    "'{}': no gyroscope is read, as there are several ({}); choose with --topics imu=TOPIC",
                    self.path.display(),
                    several.join("; ")
                );
                Ok(None)
            }
        }
    }
}

/// Where poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PoseSource {
    Topic(usize),
    Tree,
}

/// Those that fit better, where there are such.
fn narrowed<T: Clone>(all: Vec<T>, better: impl Fn(&T) -> bool) -> Vec<T> {
    let fits: Vec<T> = all.iter().filter(|one| better(one)).cloned().collect();
    if fits.is_empty() { all } else { fits }
}

/// Of several copies of a camera's images the raw one.
fn one_per_camera<'a>(all: Vec<&'a Candidate<'a>>) -> Vec<&'a Candidate<'a>> {
    let mut kept: Vec<&Candidate<'_>> = Vec::new();
    for image in all {
        match kept.iter_mut().find(|other| other.camera() == image.camera()) {
            Some(other) if other.is_compressed() && !image.is_compressed() => *other = image,
            Some(_) => {}
            None => kept.push(image),
        }
    }
    kept
}

fn describe_schema(topic: &Topic) -> String {
    let schema = if topic.schema.is_empty() { "no schema" } else { topic.schema.as_str() };
    // The usual encodings go without saying.
    if topic.kind.is_some() { schema.into() } else { format!("{schema} (encoding '{}')", topic.encoding) }
}

fn describe(topic: &Topic) -> String {
    format!("{}: {}, {} messages", topic.name, describe_schema(topic), topic.count)
}
