//! A triangle: where a ray meets it, and its point closest to another.

use nalgebra::Vector3;

/// The corners of a face.
pub(super) struct Face(pub(super) [Vector3<f64>; 3]);

impl Face {
    /// Length of the ray to the face, from either side, in units of `direction`. `None` if it misses, runs in the
    /// face's plane, or the face has no area.
    ///
    /// # Source
    /// Ericson 2005, section 5.3.6, for both sides.
    #[inline]
    pub(super) fn met(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let [a, b, c] = &self.0;
        let (ab, ac, from_a) = (b - a, c - a, origin - a);
        let normal = ab.cross(&ac);
        let (slope, height) = (normal.dot(direction), normal.dot(&from_a));
        if slope == 0.0 || (height < 0.0 && slope < 0.0) || (height > 0.0 && slope > 0.0) {
            return None;
        }
        let side = if height < 0.0 { -1.0 } else { 1.0 };
        let e = -direction.cross(&from_a);
        let v = side * ac.dot(&e);
        if v < 0.0 || v > slope.abs() {
            return None;
        }
        let w = -side * ab.dot(&e);
        (w >= 0.0 && v + w <= slope.abs()).then(|| side * height * (1.0 / slope.abs()))
    }

    /// The point of the face closest to `at`. A face without area is its longest edge.
    ///
    /// Barycentric coordinates are from cross products, which are zero for a face without area.
    ///
    /// # Source
    /// Ericson 2005, section 5.1.5: the regions of a triangle, one after the other.
    #[inline]
    pub(super) fn closest(&self, at: &Vector3<f64>) -> Vector3<f64> {
        let [a, b, c] = &self.0;
        let (ab, ac, bc) = (b - a, c - a, c - b);
        let (from_a, from_b, from_c) = (at - a, at - b, at - c);
        let (ab_a, ac_a) = (ab.dot(&from_a), ac.dot(&from_a));
        if ab_a <= 0.0 && ac_a <= 0.0 {
            return *a;
        }
        let (ab_b, ac_b) = (ab.dot(&from_b), ac.dot(&from_b));
        if ab_b >= 0.0 && ac_b <= ab_b {
            return *b;
        }
        let (ab_c, ac_c) = (ab.dot(&from_c), ac.dot(&from_c));
        if ac_c >= 0.0 && ab_c <= ac_c {
            return *c;
        }
        let normal = ab.cross(&ac);
        let share_c = normal.dot(&ab.cross(&from_a));
        if share_c < 0.0 && ab_a >= 0.0 && ab_b <= 0.0 {
            return a + ab * (ab_a / ab.norm_squared());
        }
        let share_b = -normal.dot(&ac.cross(&from_c));
        if share_b < 0.0 && ac_a >= 0.0 && ac_c <= 0.0 {
            return a + ac * (ac_a / ac.norm_squared());
        }
        let share_a = normal.dot(&bc.cross(&from_b));
        if share_a < 0.0 && ac_b - ab_b >= 0.0 && ab_c - ac_c >= 0.0 {
            return b + bc * (bc.dot(&from_b) / bc.norm_squared());
        }
        let sum = share_a + share_b + share_c;
        if sum == 0.0 {
            return self.closest_on_longest_edge(at);
        }
        a + ab * (share_b / sum) + ac * (share_c / sum)
    }

    fn closest_on_longest_edge(&self, at: &Vector3<f64>) -> Vector3<f64> {
        let [a, b, c] = &self.0;
        let (ab, ac, bc) = ((b - a).norm_squared(), (c - a).norm_squared(), (c - b).norm_squared());
        let (from, to) = if ab >= ac && ab >= bc {
            (a, b)
        } else if ac >= bc {
            (a, c)
        } else {
            (b, c)
        };
        let along = to - from;
        let share = along.dot(&(at - from));
        if share <= 0.0 {
            *from
        } else if share >= along.norm_squared() {
            *to
        } else {
            from + along * (share / along.norm_squared())
        }
    }
}
