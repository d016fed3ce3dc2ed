//! URDF: the fixed joints of a robot description, as static transforms.

use std::path::Path;

use portolan_geometry::{Quaternion, Rigid3, Vector3, rotation_from_roll_pitch_yaw};
use portolan_input::{XmlLimits, check_xml, read_all};
use portolan_issue::{Issue, Severity};
use portolan_recording::RecordingError;
use roxmltree::{Document, Node, ParsingOptions};

use crate::tf::{TfTree, frame_name};

/// Maximum size of a description, bytes.
const MAX_BYTES: u64 = 16 << 20;
/// Maximum nesting depth of the XML.
const MAX_DEPTH: usize = 200;
/// Maximum number of elements and texts: each takes some hundred bytes while the document is read.
const MAX_NODES: u32 = 1_000_000;
/// Types of joints that move (`urdf` of ROS).
const MOVING: [&str; 6] = ["revolute", "continuous", "prismatic", "floating", "planar", "spherical"];

/// One fixed joint.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedJoint {
    /// Parent frame.
    pub parent: String,
    /// Child frame.
    pub child: String,
    /// Child in the parent.
    pub parent_from_child: Rigid3,
}

/// Frames and joints of a robot description.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RobotDescription {
    /// Fixed joints in the order of the file.
    pub fixed_joints: Vec<FixedJoint>,
    /// Names of joints that move; their frames need `/tf`.
    pub moving_joints: Vec<String>,
}

/// Reads a URDF file.
///
/// # Errors
/// If the file cannot be read, is larger than 16 MiB or no text, or as for [`parse_urdf`].
pub fn read_urdf(path: &Path) -> Result<RobotDescription, RecordingError> {
    let io_error = |source| RecordingError::Io { path: path.to_owned(), source };
    let bytes = read_all(path, MAX_BYTES).map_err(|error| match error.kind() {
        std::io::ErrorKind::FileTooLarge => {
            described(path, "it is larger than 16 MiB, which no robot description is")
        }
        _ => io_error(error),
    })?;
    let text =
        String::from_utf8(bytes).map_err(|_| described(path, "it is not UTF-8 text; save it as UTF-8"))?;
    let is_xacro = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xacro"));
    parse_urdf(&text, is_xacro).map_err(|detail| described(path, &detail))
}

fn described(path: &Path, detail: &str) -> RecordingError {
    RecordingError::Description { detail: format!("{}: {detail}", path.display()) }
}

/// Parses the text of a URDF file; the error says what to do.
///
/// # Errors
/// If the text is no URDF: xacro that is not expanded, no valid XML, or another kind of document.
pub fn parse_urdf(text: &str, is_xacro: bool) -> Result<RobotDescription, String> {
    if is_xacro || text.contains("<xacro:") || text.contains("xmlns:xacro=") {
        return Err("it contains xacro macros, which must be expanded first: run `xacro robot.urdf.xacro > robot.urdf` \
                    (ROS 2: `ros2 run xacro xacro …`, ROS 1: `rosrun xacro xacro …`) and give robot.urdf"
            .to_owned());
    }
    let limits = XmlLimits { depth: MAX_DEPTH, ..XmlLimits::default() };
    check_xml(text.as_bytes(), limits).map_err(|problem| problem.to_string())?;
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| match error {
        roxmltree::Error::NodesLimitReached => {
            format!("it has more than {MAX_NODES} elements and texts, which no robot description has")
        }
        error => format!("it is not valid XML: {error}"),
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(format!(
            "it is not a URDF: it begins with <{}>, not with <robot>",
            root.tag_name().name()
        ));
    }
    let mut description = RobotDescription::default();
    // Transmissions and extensions of simulators contain elements of the same name, which are not joints.
    for joint in root.children().filter(|node| node.has_tag_name("joint")) {
        description.add(joint)?;
    }
    Ok(description)
}

/// The numbers of an attribute such as `xyz`; zeros if it is not there.
fn three_numbers(element: Option<Node<'_, '_>>, attribute: &str) -> Option<[f64; 3]> {
    let Some(text) = element.and_then(|element| element.attribute(attribute)) else { return Some([0.0; 3]) };
    let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
    numbers.try_into().ok().filter(|numbers: &[f64; 3]| numbers.iter().all(|number| number.is_finite()))
}

impl RobotDescription {
    /// Adds one joint.
    fn add(&mut self, joint: Node<'_, '_>) -> Result<(), String> {
        let name = joint.attribute("name").unwrap_or_default();
        let kind = joint.attribute("type").ok_or_else(|| format!("joint \"{name}\" has no type"))?;
        if MOVING.contains(&kind) {
            self.moving_joints.push(name.to_owned());
            return Ok(());
        }
        if kind != "fixed" {
            return Err(format!("joint \"{name}\" has the type \"{kind}\", which URDF does not know"));
        }
        let part = |name: &str| joint.children().find(|node| node.has_tag_name(name));
        let link = |end: &str| {
            let link = part(end).and_then(|part| part.attribute("link"));
            link.ok_or_else(|| format!("joint \"{name}\" has no {end} link"))
        };
        let (parent, child, origin) = (link("parent")?, link("child")?, part("origin"));
        let numbers = three_numbers(origin, "xyz").zip(three_numbers(origin, "rpy"));
        let Some((xyz, [roll, pitch, yaw])) = numbers else {
            return Err(format!("the origin of joint \"{name}\" is not three numbers each for xyz and rpy"));
        };
        let rotation: Quaternion = rotation_from_roll_pitch_yaw(roll, pitch, yaw);
        self.fixed_joints.push(FixedJoint {
            parent: frame_name(parent).to_owned(),
            child: frame_name(child).to_owned(),
            parent_from_child: Rigid3::from_parts(Vector3::from(xyz).into(), rotation),
        });
        Ok(())
    }

    /// Adds the fixed joints to a tree; returns an issue for each one that conflicts with it.
    pub fn insert_into(&self, tree: &mut TfTree) -> Vec<Issue> {
        self.fixed_joints
            .iter()
            .filter_map(|j| tree.insert_static(&j.parent, &j.child, j.parent_from_child).err())
            .map(|error| error.issue().with_severity(Severity::Info))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ROBOT: &str = r#"<robot name="r">
        <link name="base_link"/><link name="laser"/><link name="wheel"/>
        <joint name="mount" type="fixed">
          <parent link="base_link"/><child link="laser"/><origin xyz="0.2 0 0.1" rpy="3.14159265 0 0"/>
        </joint>
        <joint name="axle" type="continuous"><parent link="base_link"/><child link="wheel"/><axis xyz="0 1 0"/></joint>
    </robot>"#;

    #[test]
    fn fixed_joints_become_transforms() {
        let robot = parse_urdf(ROBOT, false).unwrap();
        assert_eq!(robot.moving_joints, ["axle"]);
        let mut tree = TfTree::new();
        assert!(robot.insert_into(&mut tree).is_empty());
        let pose = tree.lookup_static("base_link", "laser").unwrap();
        assert!((pose.translation.vector - Vector3::new(0.2, 0.0, 0.1)).norm() < 1e-12);
        assert!((pose.rotation * Vector3::z() + Vector3::z()).norm() < 1e-6);
    }

    #[test]
    fn macros_and_invalid_text_are_refused_with_advice() {
        let error = parse_urdf(r#"<robot xmlns:xacro="x"><xacro:include/></robot>"#, false).unwrap_err();
        assert!(error.contains("xacro robot.urdf.xacro > robot.urdf"));
        assert!(parse_urdf(ROBOT, true).is_err());
        assert!(parse_urdf("hello", false).is_err());
        for deep in ["<a>", "<a b='/>'>", "<!-- <b> --><a>"] {
            assert!(parse_urdf(&deep.repeat(50_000), false).unwrap_err().contains("nested"));
        }
        let many: String = (0..1000).map(|i| format!(" a{i}='1'")).collect();
        assert!(parse_urdf(&format!("<robot name='r'{many}/>"), false).unwrap_err().contains("attributes"));
        let countless = format!("<robot>{}</robot>", "<a/>".repeat(1_000_001));
        assert!(parse_urdf(&countless, false).unwrap_err().contains("1000000 elements"));
    }

    #[test]
    fn faults_of_joints_are_named() {
        let with = |joint: &str| {
            parse_urdf(&format!("<robot name='r'><gazebo><joint/></gazebo>{joint}</robot>"), false)
        };
        let joint = |attributes: &str, inside: &str| with(&format!("<joint {attributes}>{inside}</joint>"));
        let ends = "<parent link='/a'/><child link='b'/>";
        let sound = joint("name='j' type='fixed'", ends).unwrap();
        let expected =
            FixedJoint { parent: "a".into(), child: "b".into(), parent_from_child: Rigid3::identity() };
        assert_eq!(sound.fixed_joints, [expected]);
        assert_eq!(
            with("<transmission><joint name='j'/></transmission>").unwrap(),
            RobotDescription::default()
        );
        for (attributes, inside, message) in [
            ("name='j'", ends, "\"j\" has no type"),
            ("name='j' type='welded'", ends, "\"j\" has the type \"welded\""),
            ("name='j' type='fixed'", "<parent link='a'/>", "\"j\" has no child link"),
            ("type='fixed'", "<parent/><child link='b'/>", "\"\" has no parent link"),
        ] {
            let error = joint(attributes, inside).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
        for origin in
            ["xyz='1 2'", "xyz='1 2 3 4'", "xyz='1 2 x'", "rpy='0 0 nan'", "rpy='0 inf 0'", "rpy=''"]
        {
            let error = joint("name='j' type='fixed'", &format!("{ends}<origin {origin}/>")).unwrap_err();
            assert!(error.contains("origin of joint \"j\""), "{error}");
        }
        assert!(parse_urdf("<sdf/>", false).unwrap_err().contains("begins with <sdf>"));
    }

    #[test]
    fn descriptions_of_real_robots_load() {
        for (name, joints) in [("AGV_backpack_2d.urdf", 5), ("backpack_2d.urdf", 2)] {
            let Some(path) = portolan_testing::real_data(&format!("configs/{name}")) else { return };
            assert_eq!(read_urdf(&path).unwrap().fixed_joints.len(), joints, "{name}");
        }
    }

    proptest! {
        #[test]
        fn damaged_descriptions_never_panic(at in 0..ROBOT.len(), byte in any::<u8>(), cut in 0..ROBOT.len()) {
            let mut bytes = ROBOT.as_bytes().to_vec();
            bytes[at] = byte;
            bytes.truncate(cut.max(1));
            let _ = parse_urdf(&String::from_utf8_lossy(&bytes), false);
            let _ = parse_urdf(&ROBOT[..cut], false);
        }
    }
}
