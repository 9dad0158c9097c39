//! The layout of Foxglove and Lichtblick for a recording: what to show, and where to look.

use serde_json::{Map, Value as Json, json};

/// Distance of the camera from what it looks at, m: a bone fills the view.
const DISTANCE_M: f64 = 0.4;
/// Nearest visible distance, m. The default of the viewers, 0.5, hides what is 400 mm away.
const NEAR_M: f64 = 0.001;

/// Where the camera looks: a point in metres, in a frame that it follows.
pub(super) struct Focus<'a> {
    pub(super) frame: &'a str,
    pub(super) centre_m: [f64; 3],
}

/// The layout: a 3D view of every channel, by topic and schema, and the messages of the nodes below it. It is imported in
/// the viewer.
pub(super) fn layout(channels: &[(String, &str)], focus: Option<&Focus<'_>>) -> Json {
    let mut topics = Map::new();
    for (topic, schema) in channels {
        let mut settings = json!({ "visible": true });
        if *schema == "foxglove.PointCloud" {
            settings["pointSize"] = 2.into();
            settings["colorMode"] = "flat".into();
            settings["flatColor"] = "#d55e00".into();
        }
        topics.insert(topic.clone(), settings);
    }
    let centre = focus.map_or([0.0; 3], |focus| focus.centre_m);
    let scene = json!({
        "cameraState": {
            "distance": DISTANCE_M, "perspective": true, "phi": 60, "thetaOffset": 45, "fovy": 45,
            "target": [0, 0, 0], "targetOffset": centre, "targetOrientation": [0, 0, 0, 1], "near": NEAR_M, "far": 100,
        },
        "followMode": "follow-pose",
        "followTf": focus.map(|focus| focus.frame),
        "scene": { "transforms": { "axisScale": 0.05, "labelSize": 0.05, "enablePreloading": true } },
        "transforms": {}, "topics": topics, "layers": {}, "publish": {}, "imageMode": {},
    });
    json!({
        "configById": {
            "3D!run": scene,
            "RosOut!run": { "searchTerms": [], "minLogLevel": 1, "topicToRender": "/run/log" },
        },
        "globalVariables": {}, "userNodes": {}, "playbackConfig": { "speed": 1 },
        "layout": { "first": "3D!run", "second": "RosOut!run", "direction": "column", "splitPercentage": 80 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_stands_near_what_it_looks_at_and_cuts_nothing_off() {
        let channels = [("/view/bone.mesh".to_owned(), "foxglove.SceneUpdate")];
        let focus = Focus { frame: "ct", centre_m: [0.1, 0.2, -1.4] };
        let layout = layout(&channels, Some(&focus));
        let scene = &layout["configById"]["3D!run"];
        assert_eq!(scene["followTf"], "ct");
        assert_eq!(scene["cameraState"]["targetOffset"], json!([0.1, 0.2, -1.4]));
        assert_eq!((&scene["cameraState"]["near"], &scene["cameraState"]["distance"]), (&json!(0.001), &json!(0.4)));
        assert_eq!(scene["topics"]["/view/bone.mesh"]["visible"], true);
        let panels = layout["configById"].as_object().unwrap();
        assert!(["first", "second"].iter().all(|place| panels.contains_key(layout["layout"][place].as_str().unwrap())));
    }
}
