//! The layout of Foxglove and Lichtblick for a recording: what to show, and where to look.

use serde_json::{Map, Value as Json, json};
use std::collections::BTreeSet;

/// Distance of the camera from what it looks at, m: a bone fills the view.
const DISTANCE_M: f64 = 0.4;
/// Nearest visible distance, m. The default of the viewers, 0.5, hides what is 400 mm away.
const NEAR_M: f64 = 0.001;

/// Where the camera looks: a point in metres, in a frame that it follows.
pub(super) struct Focus<'a> {
    pub(super) frame: &'a str,
    pub(super) centre_m: [f64; 3],
}

/// A topic of the 3D view.
pub(super) struct Shown {
    pub(super) topic: String,
    pub(super) content: Content,
    /// Whether it is shown at first.
    pub(super) visible: bool,
}

/// What a topic has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// Points without a colour of their own.
    Cloud,
    /// Points with colours.
    Coloured,
    /// Surfaces, points, planes.
    Scene,
    /// Transforms, images.
    Other,
}

/// The layout: a 3D view with the settings of every topic, the verdict, and the messages of the nodes below it. It is imported in
/// the viewer.
pub(super) fn layout(
    channels: &[Shown],
    has_verdict: bool,
    frames: &BTreeSet<&str>,
    focus: Option<&Focus<'_>>,
) -> Json {
    let mut topics = Map::new();
    for Shown { topic, content, visible } in channels {
        let mut settings = json!({ "visible": visible });
        if matches!(content, Content::Cloud | Content::Coloured) {
            settings["pointSize"] = 2.into();
        }
        match content {
            Content::Cloud => {
                settings["colorMode"] = "flat".into();
                settings["flatColor"] = "#d55e00".into();
                // Without a field viewers choose one themselves, and a map of colours with it.
                settings["colorField"] = "x".into();
            }
            Content::Coloured => {
                settings["colorMode"] = "rgba-fields".into();
                settings["colorField"] = "distance_mm".into();
            }
            Content::Scene | Content::Other => {}
        }
        topics.insert(topic.clone(), settings);
    }
    // Axes and names of frames would hide a bone.
    let hidden: Map<_, _> =
        frames.iter().map(|frame| (format!("frame:{frame}"), json!({ "visible": false }))).collect();
    let centre = focus.map_or([0.0; 3], |focus| focus.centre_m);
    let scene = json!({
        "cameraState": {
            "distance": DISTANCE_M, "perspective": true, "phi": 60, "thetaOffset": 45, "fovy": 45,
            "target": [0, 0, 0], "targetOffset": centre, "targetOrientation": [0, 0, 0, 1], "near": NEAR_M, "far": 100,
        },
        "followMode": "follow-pose",
        "followTf": focus.map(|focus| focus.frame),
        "scene": { "transforms": { "axisScale": 0.02, "labelSize": 0.004, "showLabel": false, "enablePreloading": true } },
        "transforms": hidden, "topics": topics, "layers": {}, "publish": {}, "imageMode": {},
    });
    let mut panels = json!({
        "3D!run": scene,
        "RosOut!run": { "searchTerms": [], "minLogLevel": 1, "topicToRender": "/run/log" },
    });
    let mut below = json!("RosOut!run");
    if has_verdict {
        let rule = |(answer, color): (&str, &str)| json!({ "operator": "=", "rawValue": answer, "color": color, "label": answer });
        panels["Indicator!run"] = json!({
            "path": "/run/verdict.answer", "style": "background", "fallbackColor": "#8c9199", "fallbackLabel": "no verdict yet",
            "rules": ANSWERS.map(rule),
        });
        below = json!({ "first": "Indicator!run", "second": below, "direction": "row", "splitPercentage": 25 });
    }
    json!({
        "configById": panels,
        "globalVariables": {}, "userNodes": {}, "playbackConfig": { "speed": 1 },
        "layout": { "first": "3D!run", "second": below, "direction": "column", "splitPercentage": 80 },
    })
}

/// The answers of a verdict, and their colours on the page.
const ANSWERS: [(&str, &str); 3] = [("trusted", "#009e73"), ("doubtful", "#e69f00"), ("refused", "#d55e00")];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_stands_near_what_it_looks_at_and_cuts_nothing_off() {
        let shown = |topic: &str, content, visible| Shown { topic: topic.into(), content, visible };
        let channels = [
            shown("/view/bone.mesh", Content::Scene, true),
            shown("/view/scan.cloud", Content::Cloud, false),
            shown("/run/registered", Content::Coloured, true),
        ];
        let focus = Focus { frame: "ct", centre_m: [0.1, 0.2, -1.4] };
        let layout = layout(&channels, true, &BTreeSet::from(["ct", "world"]), Some(&focus));
        let scene = &layout["configById"]["3D!run"];
        assert_eq!(scene["followTf"], "ct");
        assert_eq!(scene["cameraState"]["targetOffset"], json!([0.1, 0.2, -1.4]));
        assert_eq!((&scene["cameraState"]["near"], &scene["cameraState"]["distance"]), (&json!(0.001), &json!(0.4)));
        assert_eq!(scene["topics"]["/view/bone.mesh"]["visible"], true);
        assert_eq!(scene["topics"]["/view/scan.cloud"]["visible"], false);
        assert_eq!(scene["topics"]["/view/scan.cloud"]["colorField"], "x", "else the colours are a rainbow");
        assert_eq!(scene["topics"]["/run/registered"]["colorMode"], "rgba-fields");
        assert_eq!(
            scene["transforms"],
            json!({ "frame:ct": { "visible": false }, "frame:world": { "visible": false } })
        );
        let below = &layout["layout"]["second"];
        let panels = layout["configById"].as_object().unwrap();
        let placed = [&layout["layout"]["first"], &below["first"], &below["second"]];
        assert!(placed.iter().all(|place| panels.contains_key(place.as_str().unwrap())), "{layout:#}");
    }
}
