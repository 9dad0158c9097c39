// The camera of a view: in perspective, or orthographic, so that lengths on the screen are lengths on the bone.

import * as THREE from "three";

const FOV_DEG = 35;
/** Half of the view's height at a distance of 1. */
const SLOPE = Math.tan((FOV_DEG * Math.PI) / 360);

/** The height of a name as a share of the view's, and the least and the greatest in pixels. */
const NAME_SHARE = 0.035, NAME_PX = [16, 26];

export class Eye {
  /** @param {boolean} isOrthographic */
  constructor(isOrthographic) {
    this.camera = isOrthographic ? new THREE.OrthographicCamera() : new THREE.PerspectiveCamera(FOV_DEG, 1, 0.001, 20);
    this.camera.position.set(0.3, 0.3, 0.3);
    this.aspect = 1;
    this.height = 0;
  }

  /** @param {number} width @param {number} height of the view, pixels */
  resize(width, height) {
    const { camera } = this;
    this.aspect = width / height;
    this.height = height;
    if (camera instanceof THREE.PerspectiveCamera) camera.aspect = this.aspect;
    else [camera.left, camera.right] = [-this.aspect * camera.top, this.aspect * camera.top];
    camera.updateProjectionMatrix();
  }

  /**
   * Looks at a place.
   * @param {THREE.Vector3} centre
   * @param {THREE.Vector3} from the direction from there to the viewer
   * @param {THREE.Vector3} up
   * @param {number} half of what is seen in the view's height
   * @param {number} length of all that is drawn
   */
  look(centre, from, up, half, length) {
    const { camera } = this;
    const isOrthographic = camera instanceof THREE.OrthographicCamera;
    camera.up.copy(up);
    camera.position.copy(centre).addScaledVector(from, isOrthographic ? 4 * length : half / SLOPE);
    camera.near = isOrthographic ? 0 : length / 500;
    camera.far = isOrthographic ? 8 * length : length * 20;
    if (isOrthographic) [camera.left, camera.right, camera.top, camera.bottom, camera.zoom] = [-half * this.aspect, half * this.aspect, half, -half, 1];
    camera.updateProjectionMatrix();
  }

  /** Half of the view's height where it is looked at, in the scene's metres. @param {THREE.Vector3} target */
  half(target) {
    const { camera } = this;
    return camera instanceof THREE.OrthographicCamera ? camera.top / camera.zoom : camera.position.distanceTo(target) * SLOPE;
  }

  /** How much more of the view's height what is this much nearer takes than where it is looked at, in the scene's metres. @param {number} nearer */
  growth(nearer) { return this.camera instanceof THREE.OrthographicCamera ? 0 : nearer * SLOPE; }

  /** How many times its given size a name must have, so that it is as large on the screen as in perspective, and can be read in a view of any height. */
  nameScale() {
    const [least, most] = NAME_PX;
    const px = NAME_SHARE * this.height;
    const readable = px > 0 ? Math.min(Math.max(px, least), most) / px : 1;
    return readable * (this.camera instanceof THREE.OrthographicCamera ? this.camera.top / this.camera.zoom / SLOPE : 1);
  }
}
