//! Connected areas of one colour in an image.

use osteoflow_geometry::Image;

/// Pixels that count.
pub(super) struct Mask {
    width: usize,
    height: usize,
    inside: Vec<bool>,
}

impl Mask {
    /// The pixels within `radius` of a centre.
    pub(super) fn of(image: &Image, centres: impl Iterator<Item = [f64; 2]>, radius: f64) -> Self {
        let mut mask = Self { inside: Vec::new(), ..Self::all(image) };
        mask.inside = vec![false; mask.width * mask.height];
        let bound = |c: f64, side: usize| c.clamp(0.0, side as f64 - 1.0) as usize;
        for [u, v] in centres {
            for y in bound((v - radius).ceil(), mask.height)..=bound((v + radius).floor(), mask.height) {
                for x in bound((u - radius).ceil(), mask.width)..=bound((u + radius).floor(), mask.width) {
                    if (x as f64 - u).hypot(y as f64 - v) <= radius {
                        mask.inside[y * mask.width + x] = true;
                    }
                }
            }
        }
        mask
    }

    /// All pixels.
    pub(super) fn all(image: &Image) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        Self { width, height, inside: vec![true; width * height] }
    }

    /// Column and row of each pixel that counts.
    pub(super) fn pixels(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let inside = self.inside.iter().enumerate().filter(|(_, inside)| **inside);
        inside.map(|(index, _)| [index % self.width, index / self.width])
    }
}

/// The order of an image's channels.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Channels {
    /// As they are.
    Rgb,
    /// With red and blue exchanged.
    Bgr,
}

/// A connected area of the colour, with the saturated pixels that it encloses.
pub(super) struct Blob {
    /// Mean column and row.
    pub(super) centre: [f64; 2],
    pub(super) n_pixels: usize,
    /// Where the colour falls below the threshold towards bone, between two pixels; nothing where it borders on saturated pixels or on the
    /// mask's end.
    pub(super) rim: Vec<[f64; 2]>,
}

/// What a pixel is.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Outside,
    Bone,
    /// Without colour because a channel is saturated.
    Saturated,
    Coloured,
}

/// The blobs whose `strength` is `min_contrast` above the median of the mask.
///
/// Other pixels with a channel at `saturated` or more have lost their colour: they connect nothing, and belong to the blob that
/// encloses them.
pub(super) fn blobs(
    image: &Image,
    mask: &Mask,
    channels: Channels,
    strength: &dyn Fn([f64; 3]) -> f64,
    min_contrast: f64,
    saturated: u8,
) -> Vec<Blob> {
    let (width, height) = (mask.width, mask.height);
    let size = [width, height];
    let strength_of = |[x, y]: [usize; 2]| {
        let [red, green, blue] = image.rgb(x, y).map(f64::from);
        strength(if channels == Channels::Rgb { [red, green, blue] } else { [blue, green, red] })
    };
    let strengths: Vec<f64> = (0..width * height)
        .map(|i| if mask.inside[i] { strength_of([i % width, i / width]) } else { f64::NEG_INFINITY })
        .collect();
    let mut on_mask: Vec<f64> = strengths.iter().copied().filter(|s| s.is_finite()).collect();
    let threshold = crate::median::median(&mut on_mask) + min_contrast;
    let mut kinds: Vec<Kind> = (0..width * height)
        .map(|i| match mask.inside[i] {
            false => Kind::Outside,
            true if strengths[i] >= threshold => Kind::Coloured,
            true if image.rgb(i % width, i / width).iter().any(|c| *c >= saturated) => Kind::Saturated,
            true => Kind::Bone,
        })
        .collect();
    // What colour alone encloses is its core.
    let of_kind = |kinds: &[Kind], kind: Kind| -> Vec<bool> { kinds.iter().map(|k| *k == kind).collect() };
    for area in areas(of_kind(&kinds, Kind::Saturated), size) {
        let around = area.iter().flat_map(|&i| neighbours(i, size)).filter(|&j| kinds[j] != Kind::Saturated);
        let (mut coloured, mut other) = (0usize, 0usize);
        around.for_each(|j| if kinds[j] == Kind::Coloured { coloured += 1 } else { other += 1 });
        if coloured > 0 && other == 0 {
            area.iter().for_each(|&i| kinds[i] = Kind::Coloured);
        }
    }
    let blob = |area: Vec<usize>| {
        let n = area.len() as f64;
        let sum = area.iter().fold([0.0, 0.0], |[u, v], &i| [u + (i % width) as f64, v + (i / width) as f64]);
        let mut rim = Vec::new();
        for &i in &area {
            for j in neighbours(i, size).filter(|&j| kinds[j] == Kind::Bone) {
                // Linear between the centres of both pixels; the core has no strength of its own.
                let (here, there) = (strengths[i].max(threshold), strengths[j]);
                let share = ((here - threshold) / (here - there).max(1e-9)).clamp(0.0, 1.0);
                let [a, b] = [i, j].map(|k| [(k % width) as f64, (k / width) as f64]);
                rim.push([0, 1].map(|k| a[k] + share * (b[k] - a[k])));
            }
        }
        Blob { centre: [sum[0] / n, sum[1] / n], n_pixels: area.len(), rim }
    };
    areas(of_kind(&kinds, Kind::Coloured), size).into_iter().map(blob).collect()
}

/// The four neighbours of a pixel.
pub(super) fn neighbours(i: usize, [width, height]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (x, y) = (i % width, i / width);
    let all = [(x > 0, -1), (x + 1 < width, 1), (y > 0, -(width as isize)), (y + 1 < height, width as isize)];
    all.into_iter().filter(|(is_there, _)| *is_there).map(move |(_, step)| i.wrapping_add_signed(step))
}

/// Connected areas of the pixels that are `left`, in the order of their first pixels.
pub(super) fn areas(mut left: Vec<bool>, size: [usize; 2]) -> Vec<Vec<usize>> {
    let mut areas = Vec::new();
    for first in 0..left.len() {
        if !std::mem::take(&mut left[first]) {
            continue;
        }
        let (mut area, mut next) = (vec![first], 0);
        while let Some(&here) = area.get(next) {
            next += 1;
            area.extend(neighbours(here, size).filter(|&i| std::mem::take(&mut left[i])));
        }
        areas.push(area);
    }
    areas
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::Intrinsics;

    const SIDE: usize = 60;

    /// An image of bone with what `paint` puts on it, and its red blobs.
    fn red(paint: impl Fn(f64, f64) -> Option<[u8; 3]>) -> Vec<Blob> {
        let pixels: Vec<u8> = (0..SIDE * SIDE)
            .flat_map(|i| paint((i % SIDE) as f64, (i / SIDE) as f64).unwrap_or([150, 138, 117]))
            .collect();
        let intrinsics = Intrinsics::pinhole(100.0, 100.0, 30.0, 30.0);
        let image = Image::new("camera", [SIDE as u32; 2], 3, intrinsics, pixels).unwrap();
        let strength = |[red, green, blue]: [f64; 3]| red - green.max(blue);
        blobs(&image, &Mask::all(&image), Channels::Rgb, &strength, 40.0, 250)
    }

    fn spot(x: f64, y: f64) -> Option<[u8; 3]> {
        match (x - 25.0).hypot(y - 31.0) {
            r if r < 5.0 => Some([255; 3]),
            r if r < 9.0 => Some([255, 140, 120]),
            _ => None,
        }
    }

    #[test]
    fn a_white_core_belongs_to_the_red_ring_around_it_and_white_alone_is_glare() {
        let spots = red(|x, y| spot(x, y).or(((x - 50.0).hypot(y - 10.0) < 4.0).then_some([255; 3])));
        assert_eq!(spots.len(), 1);
        let Blob { centre, n_pixels, rim } = &spots[0];
        assert!((centre[0] - 25.0).abs() < 0.1 && (centre[1] - 31.0).abs() < 0.1, "{centre:?}");
        assert!((*n_pixels as f64 / 254.5 - 1.0).abs() < 0.05, "{n_pixels} pixels");
        assert!(rim.iter().all(|[u, v]| ((u - 25.0).hypot(v - 31.0) - 9.0).abs() < 1.0), "{rim:?}");
    }

    #[test]
    fn glare_over_a_part_of_a_spot_takes_its_rim_and_moves_none_of_the_rest() {
        let spots = red(|x, y| if (x - 35.0).hypot(y - 31.0) < 6.0 { Some([255; 3]) } else { spot(x, y) });
        assert_eq!(spots.len(), 1);
        let rim = &spots[0].rim;
        assert!(rim.iter().all(|[u, v]| ((u - 25.0).hypot(v - 31.0) - 9.0).abs() < 1.2), "{rim:?}");
        assert!(rim.iter().all(|[u, _]| *u < 34.0), "{rim:?}");
    }

    #[test]
    fn a_uniform_image_has_no_blob_whatever_its_colour() {
        assert!(red(|_, _| None).is_empty());
        assert!(red(|_, _| Some([200, 40, 40])).is_empty(), "the bone's own colour is none");
    }
}
