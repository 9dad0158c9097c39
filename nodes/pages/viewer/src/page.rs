//! The files of the page, which are part of the program.

use crate::{access::token, door::Role, http::Response};

/// A file: its path below the page, its content type and its content.
type File = (&'static str, &'static str, &'static str);

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

const INDEX: &str = include_str!("../page/index.html");

/// Where the index has the nonce of its one inline script, the map of imports.
const NONCE: &str = "NONCE";

const FILES: &[File] = &[
    ("page.css", STYLE, include_str!("../page/page.css")),
    ("main.js", SCRIPT, include_str!("../page/main.js")),
    ("connection.js", SCRIPT, include_str!("../page/connection.js")),
    ("region.js", SCRIPT, include_str!("../page/region.js")),
    ("shapes.js", SCRIPT, include_str!("../page/shapes.js")),
    ("request.js", SCRIPT, include_str!("../page/request.js")),
    ("message.js", SCRIPT, include_str!("../page/message.js")),
    ("frames.js", SCRIPT, include_str!("../page/frames.js")),
    ("changes.js", SCRIPT, include_str!("../page/changes.js")),
    ("graph.js", SCRIPT, include_str!("../page/graph.js")),
    ("scene.js", SCRIPT, include_str!("../page/scene.js")),
    ("drawables.js", SCRIPT, include_str!("../page/drawables.js")),
    ("eye.js", SCRIPT, include_str!("../page/eye.js")),
    ("trackball.js", SCRIPT, include_str!("../page/trackball.js")),
    ("beside.js", SCRIPT, include_str!("../page/beside.js")),
    ("next.js", SCRIPT, include_str!("../page/next.js")),
    ("times.js", SCRIPT, include_str!("../page/times.js")),
    ("load.js", SCRIPT, include_str!("../page/load.js")),
    ("layers.js", SCRIPT, include_str!("../page/layers.js")),
    ("residual_colours.js", SCRIPT, include_str!("../page/residual_colours.js")),
    ("devices.js", SCRIPT, include_str!("../page/devices.js")),
    ("surface.js", SCRIPT, include_str!("../page/surface.js")),
    ("picks.js", SCRIPT, include_str!("../page/picks.js")),
    ("marks.js", SCRIPT, include_str!("../page/marks.js")),
    ("pick.js", SCRIPT, include_str!("../page/pick.js")),
    ("aim.js", SCRIPT, include_str!("../page/aim.js")),
    ("gestures.js", SCRIPT, include_str!("../page/gestures.js")),
    ("pick_view.js", SCRIPT, include_str!("../page/pick_view.js")),
    ("shown_plan.js", SCRIPT, include_str!("../page/shown_plan.js")),
    ("shade.js", SCRIPT, include_str!("../page/shade.js")),
    ("pick_panel.js", SCRIPT, include_str!("../page/pick_panel.js")),
    ("residual.js", SCRIPT, include_str!("../page/residual.js")),
    ("verdict.js", SCRIPT, include_str!("../page/verdict.js")),
    ("three/three.module.min.js", SCRIPT, include_str!("../page/three/three.module.min.js")),
    ("three/three.core.min.js", SCRIPT, include_str!("../page/three/three.core.min.js")),
    ("three/LICENSE", "text/plain; charset=utf-8", THREE_LICENSE),
];

/// The text of a script of the page, such as `scene.js`, for other pages that show the same.
pub fn script(path: &str) -> Option<&'static str> {
    FILES.iter().find(|(known, content_type, _)| *known == path && *content_type == SCRIPT).map(|(_, _, text)| *text)
}

/// The licence of three.js, which goes with every copy.
pub const THREE_LICENSE: &str = include_str!("../page/three/LICENSE");

/// The file at a path; pages of `origins` may show it in a frame, as a notebook does.
pub(crate) fn file(path: &str, origins: &[(String, Role)]) -> Option<Response> {
    if path.is_empty() {
        return Some(index(origins));
    }
    let (_, content_type, content) = FILES.iter().find(|(known, _, _)| *known == path)?;
    Some(Response::new(200, content_type, content.as_bytes().to_vec()))
}

/// The page itself. It may load nothing but what this server has.
fn index(origins: &[(String, Role)]) -> Response {
    let Ok(nonce) = token() else { return Response::refused(500, "the system gives no random numbers") };
    let names: Vec<&str> = origins.iter().map(|(origin, _)| origin.as_str()).collect();
    let mut page = Response::new(200, HTML, INDEX.replace(NONCE, &nonce).into_bytes());
    page.headers = format!(
        "Content-Security-Policy: default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self'; img-src 'self' \
         data: blob:; connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors {}\r\n",
        if origins.is_empty() { "'none'".to_owned() } else { names.join(" ") }
    );
    page
}
