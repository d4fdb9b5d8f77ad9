//! Areas and volumes where cells differ in size, in whole numbers.

/// Units of an area: 2⁻¹⁰ m².
const AREA_UNIT: f64 = (1u64 << 10) as f64;
/// Units of a difference: 2⁻²⁰ m.
const HEIGHT_UNIT: f64 = (1u64 << 20) as f64;

/// What cells cover, and what lies between both models there. Does not depend on the order.
#[derive(Clone, Copy, Default)]
pub(super) struct Extent {
    area: i128,
    volume: i128,
}

impl Extent {
    pub(super) fn add(&mut self, difference: f32, cell_m2: f64) {
        let area = (cell_m2 * AREA_UNIT).round() as i128;
        self.area += area;
        self.volume += area * (f64::from(difference) * HEIGHT_UNIT).round() as i64 as i128;
    }

    pub(super) fn merge(&mut self, other: &Extent) {
        self.area += other.area;
        self.volume += other.volume;
    }

    pub(super) fn area_m2(&self) -> f64 {
        self.area as f64 / AREA_UNIT
    }

    pub(super) fn volume_m3(&self) -> f64 {
        self.volume as f64 / (AREA_UNIT * HEIGHT_UNIT)
    }
}
