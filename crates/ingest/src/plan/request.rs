//! Resolves what the user, the configuration and remappings ask for to existing topics.

use portolan_issue::Severity;

use super::{Chosen, Notice, PlanError};
use crate::options::{ConfiguredSensors, IngestOptions};
use crate::survey::{Inventory, TopicSurvey, is_range};

/// Sensors that were requested by name, and those that are not wanted.
#[derive(Clone, Debug, Default)]
pub(super) struct Request<'a> {
    /// Empty: to be chosen.
    pub range: Vec<Chosen<'a>>,
    pub odometry: Option<Chosen<'a>>,
    pub imu: Option<Chosen<'a>>,
    pub nav_sat: Option<Chosen<'a>>,
    pub landmarks: Option<Chosen<'a>>,
    pub fixed_frame_pose: Option<Chosen<'a>>,
    /// Whether to look for one if none was asked for.
    pub find_odometry: bool,
    pub find_imu: bool,
    pub notices: Vec<Notice>,
}

/// A kind of sensor in requests.
#[derive(Clone, Copy)]
struct Kind {
    /// Its name in messages.
    name: &'static str,
    /// Name in configurations.
    default_name: &'static str,
    types: &'static [&'static str],
}

const SCAN: Kind = Kind { name: "laser scan", default_name: "scan", types: &["sensor_msgs/LaserScan"] };
const ECHOES: Kind =
    Kind { name: "multi-echo scan", default_name: "echoes", types: &["sensor_msgs/MultiEchoLaserScan"] };
const POINTS: Kind =
    Kind { name: "point cloud", default_name: "points2", types: &["sensor_msgs/PointCloud2"] };
const RANGE: Kind = Kind {
    name: "laser scan or point cloud",
    default_name: "",
    types: &["sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan", "sensor_msgs/PointCloud2"],
};
const ODOMETRY: Kind = Kind { name: "odometry", default_name: "odom", types: &["nav_msgs/Odometry"] };
const IMU: Kind = Kind { name: "IMU", default_name: "imu", types: &["sensor_msgs/Imu"] };
const NAV_SAT: Kind = Kind { name: "satellite fix", default_name: "fix", types: &["sensor_msgs/NavSatFix"] };
const LANDMARKS: Kind =
    Kind { name: "landmark", default_name: "landmark", types: &["cartographer_ros_msgs/LandmarkList"] };
const FIXED_POSE: Kind =
    Kind { name: "fixed-frame pose", default_name: "", types: &["geometry_msgs/PoseStamped"] };

impl<'a> Request<'a> {
    /// Finds the requested topics; a requested topic that does not exist is an error.
    pub fn new(inventory: &'a Inventory, options: &IngestOptions) -> Result<Self, PlanError> {
        let mut finder = Finder { inventory, options, notices: Vec::new() };
        let mut request = Self::default();
        for topic in &options.range_topics {
            let survey = finder.required(RANGE, topic)?;
            if !request.range.iter().any(|c: &Chosen| c.topic() == &*survey.info.topic) {
                request.range.push(Chosen::named_after_topic(survey));
            }
        }
        let configured = options.configured.as_ref();
        if request.range.is_empty() {
            request.range = match configured {
                Some(configured) => finder.configured_range(configured)?,
                None => finder.remapped_range()?,
            };
        }
        let single = |finder: &mut Finder<'a, '_>, kind, topic: &Option<String>, used: bool, needed: bool| {
            if used { finder.single(kind, topic.as_deref(), needed) } else { Ok(None) }
        };
        let used = |wish: Option<bool>, configured: Option<bool>| wish.or(configured).unwrap_or(true);
        let use_odometry = used(options.use_odometry, configured.and_then(|c| c.use_odometry));
        let use_imu = used(options.use_imu, configured.and_then(|c| c.use_imu));
        let use_landmarks = used(options.use_landmarks, configured.and_then(|c| c.use_landmarks));
        // Fixes have errors of metres, so they are used only on request.
        let use_nav_sat = options.nav_sat_topic.is_some()
            || options.use_nav_sat.or(configured.and_then(|c| c.use_nav_sat)).unwrap_or(false);
        let wanted = |wish: Option<bool>, configured: Option<bool>| wish.or(configured).unwrap_or(false);
        let want_imu = wanted(options.use_imu, configured.and_then(|c| c.use_imu));
        let want_landmarks = wanted(options.use_landmarks, configured.and_then(|c| c.use_landmarks));
        request.odometry = single(&mut finder, ODOMETRY, &options.odometry_topic, use_odometry, false)?;
        request.imu = single(&mut finder, IMU, &options.imu_topic, use_imu, want_imu)?;
        request.nav_sat = single(&mut finder, NAV_SAT, &options.nav_sat_topic, use_nav_sat, use_nav_sat)?;
        request.landmarks =
            single(&mut finder, LANDMARKS, &options.landmark_topic, use_landmarks, want_landmarks)?;
        if use_landmarks && request.landmarks.is_none() {
            request.landmarks = finder.of_kind(LANDMARKS).first().map(|s| Chosen::named_after_topic(s));
        }
        if let Some(topic) = &options.fixed_frame_pose_topic {
            request.fixed_frame_pose = Some(Chosen::named_after_topic(finder.required(FIXED_POSE, topic)?));
        }
        request.find_odometry = use_odometry && request.odometry.is_none();
        request.find_imu = use_imu && request.imu.is_none();
        request.notices = finder.notices;
        Ok(request)
    }
}

struct Finder<'a, 'o> {
    inventory: &'a Inventory,
    options: &'o IngestOptions,
    notices: Vec<Notice>,
}

impl<'a> Finder<'a, '_> {
    fn of_kind(&self, kind: Kind) -> Vec<&'a TopicSurvey> {
        let inventory: &'a Inventory = self.inventory;
        inventory
            .topics
            .iter()
            .filter(|t| kind.types.contains(&&*t.info.type_name) && (t.seen > 0 || t.info.count != Some(0)))
            .collect()
    }

    fn available(&self, kind: Kind) -> String {
        let names: Vec<&str> = self.of_kind(kind).iter().map(|t| &*t.info.topic).collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    }

    /// The topic, which must exist and be of the kind.
    fn required(&self, kind: Kind, topic: &str) -> Result<&'a TopicSurvey, PlanError> {
        let inventory: &'a Inventory = self.inventory;
        let Some(survey) = inventory.topic(topic) else {
            return Err(PlanError::NoTopic {
                asked: format!("a {} was asked for", kind.name),
                topic: topic.to_owned(),
                available: self.available(kind),
            });
        };
        if !kind.types.contains(&&*survey.info.type_name) {
            return Err(PlanError::WrongType {
                topic: survey.info.topic.to_string(),
                type_name: survey.info.type_name.to_string(),
                wanted: kind.types.join(" or "),
                available: self.available(kind),
            });
        }
        Ok(survey)
    }

    fn remapped(&self, name: &str) -> Option<&str> {
        let plain = |n: &str| n.trim_start_matches('/').to_owned();
        self.options.remappings.iter().find(|(from, _)| plain(from) == plain(name)).map(|(_, to)| to.as_str())
    }

    /// Finds a sensor of which there is one at most: by its topic, by a remapping of its name, or, if needed,
    /// by its name or as the only topic of its type.
    fn single(
        &mut self,
        kind: Kind,
        topic: Option<&str>,
        needed: bool,
    ) -> Result<Option<Chosen<'a>>, PlanError> {
        if let Some(topic) = topic {
            return Ok(Some(Chosen::named_after_topic(self.required(kind, topic)?)));
        }
        if let Some(topic) = self.remapped(kind.default_name) {
            let survey = self.required(kind, topic)?;
            return Ok(Some(Chosen { name: kind.default_name.to_owned(), survey }));
        }
        if !needed {
            return Ok(None);
        }
        if let Ok(survey) = self.required(kind, kind.default_name) {
            return Ok(Some(Chosen::named_after_topic(survey)));
        }
        match self.of_kind(kind).as_slice() {
            [] => {
                let text = format!("{} was asked for, but the recording has no such topic", kind.name);
                self.notices.push(Notice { text, change: String::new(), severity: Severity::Info });
                Ok(None)
            }
            [only] => Ok(Some(Chosen::named_after_topic(only))),
            _ => Err(PlanError::NoTopic {
                asked: format!("a {} was asked for and there are several", kind.name),
                topic: kind.default_name.to_owned(),
                available: self.available(kind),
            }),
        }
    }

    /// The topics `scan`, `scan_1`, …, numbered as in the configuration.
    fn configured_range(&mut self, configured: &ConfiguredSensors) -> Result<Vec<Chosen<'a>>, PlanError> {
        let counts = [
            (SCAN, configured.num_laser_scans),
            (ECHOES, configured.num_multi_echo_laser_scans),
            (POINTS, configured.num_point_clouds),
        ];
        let mut chosen: Vec<Chosen> = Vec::new();
        for (kind, count) in counts {
            let names: Vec<String> = match count {
                0 => Vec::new(),
                1 => vec![kind.default_name.to_owned()],
                // Names beyond the number of topics cannot be found anyway.
                n => (1..=n.min(self.inventory.topics.len() + 1))
                    .map(|i| format!("{}_{i}", kind.default_name))
                    .collect(),
            };
            chosen.extend(self.configured_names(kind, names)?);
        }
        if chosen.is_empty() {
            return Err(PlanError::Option {
                detail: "the configuration has neither num_laser_scans, num_multi_echo_laser_scans nor \
                         num_point_clouds; set one of them to at least 1"
                    .to_owned(),
            });
        }
        Ok(chosen)
    }

    fn configured_names(&mut self, kind: Kind, names: Vec<String>) -> Result<Vec<Chosen<'a>>, PlanError> {
        let mut chosen = Vec::new();
        let mut missing = Vec::new();
        for name in names {
            let topic = self.remapped(&name).unwrap_or(&name).to_owned();
            match self.required(kind, &topic) {
                Ok(survey) => chosen.push(Chosen { name, survey }),
                Err(error) if self.remapped(&name).is_some() => return Err(error),
                Err(error) => missing.push((name, error)),
            }
        }
        let taken: Vec<&str> = chosen.iter().map(|c| &*c.survey.info.topic).collect();
        let free: Vec<&TopicSurvey> =
            self.of_kind(kind).into_iter().filter(|t| !taken.contains(&&*t.info.topic)).collect();
        if free.len() != missing.len() {
            return missing.into_iter().next().map_or(Ok(chosen), |(_, error)| Err(error));
        }
        for ((name, _), survey) in missing.into_iter().zip(free) {
            let topic = &survey.info.topic;
            self.notices.push(Notice {
                severity: Severity::Info,
                text: format!(
                    "the configuration expects \"{name}\", which is not recorded; {topic} is used for it"
                ),
                change: format!("--remap {name}:=<topic>"),
            });
            chosen.push(Chosen { name, survey });
        }
        Ok(chosen)
    }

    /// Range sensors that are given only by remappings.
    fn remapped_range(&mut self) -> Result<Vec<Chosen<'a>>, PlanError> {
        let mut chosen = Vec::new();
        for (from, to) in &self.options.remappings {
            let name = from.trim_start_matches('/');
            let numbered = |kind: Kind| {
                name.strip_prefix(kind.default_name).is_some_and(|rest| {
                    rest.is_empty() || rest.strip_prefix('_').is_some_and(|n| n.parse::<u32>().is_ok())
                })
            };
            if let Some(kind) = [SCAN, ECHOES, POINTS].into_iter().find(|kind| numbered(*kind)) {
                chosen.push(Chosen { name: name.to_owned(), survey: self.required(kind, to)? });
            }
        }
        debug_assert!(chosen.iter().all(|c: &Chosen| is_range(&c.survey.info.type_name)));
        Ok(chosen)
    }
}
