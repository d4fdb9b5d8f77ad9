//! Numbers that carry their derivatives (forward mode), so that the projection is written once and its Jacobian is
//! exact.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// What a projection needs of a number.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    fn of(value: f64) -> Self;
    fn value(self) -> f64;
    fn sqrt(self) -> Self;
    fn atan2(self, x: Self) -> Self;
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn atan2(self, x: Self) -> Self {
        f64::atan2(self, x)
    }
}

/// A value and its derivatives by `N` variables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    pub v: f64,
    pub d: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// A number that depends on no variable.
    #[inline]
    pub fn constant(v: f64) -> Self {
        Dual { v, d: [0.0; N] }
    }
    /// The variable of number `index`.
    #[inline]
    pub fn variable(v: f64, index: usize) -> Self {
        let mut d = [0.0; N];
        d[index] = 1.0;
        Dual { v, d }
    }
    #[inline]
    fn chain(self, v: f64, slope: f64) -> Self {
        Dual { v, d: self.d.map(|d| d * slope) }
    }
    #[inline]
    fn both(self, other: Self, v: f64, a: f64, b: f64) -> Self {
        let mut d = [0.0; N];
        for i in 0..N {
            d[i] = a * self.d[i] + b * other.d[i];
        }
        Dual { v, d }
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        self.both(o, self.v + o.v, 1.0, 1.0)
    }
}
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        self.both(o, self.v - o.v, 1.0, -1.0)
    }
}
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[inline]
    fn mul(self, o: Self) -> Self {
        self.both(o, self.v * o.v, o.v, self.v)
    }
}
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[inline]
    fn div(self, o: Self) -> Self {
        let q = self.v / o.v;
        self.both(o, q, 1.0 / o.v, -q / o.v)
    }
}
impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        self.chain(-self.v, -1.0)
    }
}
impl<const N: usize> Real for Dual<N> {
    #[inline]
    fn of(value: f64) -> Self {
        Dual::constant(value)
    }
    #[inline]
    fn value(self) -> f64 {
        self.v
    }
    #[inline]
    fn sqrt(self) -> Self {
        let root = self.v.sqrt();
        // At zero the slope is infinite; callers take another branch there.
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        let n = self.v * self.v + x.v * x.v;
        // At a pole all longitudes meet, and none has a slope.
        let [a, b] = if n > 0.0 { [x.v / n, -self.v / n] } else { [0.0; 2] };
        self.both(x, self.v.atan2(x.v), a, b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formula<T: Real>(a: T, b: T) -> T {
        (a * a + T::of(2.0) * b).sqrt().atan2(b / a) - a * -b
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (a, b, h) = (1.3, 0.7, 1e-6);
        let exact = formula(Dual::<2>::variable(a, 0), Dual::<2>::variable(b, 1));
        assert!((exact.v - formula(a, b)).abs() < 1e-15);
        assert!((exact.d[0] - (formula(a + h, b) - formula(a - h, b)) / (2.0 * h)).abs() < 1e-8);
        assert!((exact.d[1] - (formula(a, b + h) - formula(a, b - h)) / (2.0 * h)).abs() < 1e-8);
    }
}
