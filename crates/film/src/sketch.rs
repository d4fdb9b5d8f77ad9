//! Marks drawn for one frame, each once. A cross, a ring or a dot looks the same turned by a quarter, so that all of a
//! frame's crosses are one drawing, however each is turned.

use std::cell::OnceCell;
use std::rc::Rc;

use super::picture::Picture;
use super::refine::Refiner;
use super::template::{Linear, Model};

/// Least squares of a whole mark reach so many times as far as the mark: to the corners of its box, or round marks.
const REFINED: f64 = 1.5;
const REFINED_ROUND: f64 = 1.02;
/// Drawings are the same when the scan's pixels under their rims are, to a small part of one.
const SAME: f64 = 1e-6;

/// A mark as one frame shows it.
pub(super) struct Sketch<'a> {
    pub picture: Picture<'a>,
    refiner: OnceCell<Option<Refiner>>,
}

impl Sketch<'_> {
    /// For the whole mark; `None` for a degenerate pose.
    pub fn refiner(&self) -> Option<&Refiner> {
        let Picture { model, linear, .. } = self.picture;
        self.refiner.get_or_init(|| Refiner::new(model, linear, refined_mm(model))).as_ref()
    }
}

/// The marks drawn so far. Only those that others may look like are kept: drawings are large.
#[derive(Default)]
pub(super) struct Sketches<'a> {
    kept: Vec<Rc<Sketch<'a>>>,
}

impl<'a> Sketches<'a> {
    /// The mark as drawn before under nearly this map of millimetres to pixels, else drawn now.
    pub fn of(&mut self, model: &'a Model, linear: Linear) -> Rc<Sketch<'a>> {
        let size = linear.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let close = |other: &Linear| other.iter().zip(&linear).all(|(a, b)| (a - b).abs() <= SAME * size);
        let same = |s: &&Rc<Sketch>| std::ptr::eq(s.picture.model, model) && close(&s.picture.linear);
        if let Some(known) = self.kept.iter().find(same) {
            return known.clone();
        }
        let sketch = Rc::new(Sketch { picture: Picture::new(model, linear), refiner: OnceCell::new() });
        if model.is_alike_by_quarters() {
            self.kept.push(sketch.clone());
        }
        sketch
    }
}

/// How far the least squares of a whole mark reach.
pub(super) fn refined_mm(model: &Model) -> f64 {
    model.radius_mm() * if model.sectors_deg().is_some() { REFINED_ROUND } else { REFINED }
}

/// Of the ways a shape that looks the same under every quarter of a turn may be said to lie, the one whose right points
/// most to the scan's right.
pub(super) fn upright([a, b, c, d]: Linear) -> Linear {
    let ways = [[a, b, c, d], [b, -a, d, -c], [-a, -b, -c, -d], [-b, a, -d, c]];
    ways.into_iter().max_by(|m, n| m[0].total_cmp(&n[0])).expect("four ways")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interior::Pose;
    use crate::template::draw;
    use crate::types::MarkKind;

    #[test]
    fn crosses_turned_by_quarters_are_one_drawing_and_show_what_each_would() {
        let kind = MarkKind::RingCross {
            ring_diameter_mm: 1.6,
            line_mm: 0.22,
            arm_from_mm: 0.32,
            arm_to_mm: 1.4,
            arm_line_mm: 0.09,
            lines_deg: 30.0,
        };
        let model = Model::Drawn(kind);
        let pose = Pose::about(
            [0.0, 0.0],
            autoref_raster::coords::PixelPoint { x: 0.0, y: 0.0 },
            17.0,
            3.0,
            autoref_raster::coords::Handedness::AsIs,
        );
        let mut sketches = Sketches::default();
        let first = sketches.of(&model, upright(pose.shape_linear(0.0)));
        let expected = draw(&model, pose.shape_linear(0.0), 1.0, None).expect("has contrast");
        for turn in [90.0, 180.0, 270.0] {
            assert!(Rc::ptr_eq(&first, &sketches.of(&model, upright(pose.shape_linear(turn)))), "{turn}");
            let turned = draw(&model, pose.shape_linear(turn), 1.0, None).expect("has contrast");
            let off = turned.values.iter().zip(&expected.values).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
            // A sample on an edge may fall to either side.
            assert!(off < expected.values.len() / 100, "{turn}: {off}");
        }
        // Turned by anything else, or mirrored, it is another.
        assert!(!Rc::ptr_eq(&first, &sketches.of(&model, upright(pose.shape_linear(45.0)))));
        let [a, b, c, d] = pose.shape_linear(0.0);
        assert!(!Rc::ptr_eq(&first, &sketches.of(&model, upright([-a, b, -c, d]))));
    }
}
