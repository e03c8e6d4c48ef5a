//! The rectangle that a query asks for.

use super::problem::Problem;
use crate::store::Within;

/// A rectangle in the map frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BoundingBox {
    x: [f64; 2],
    y: [f64; 2],
}

impl std::str::FromStr for BoundingBox {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self, Problem> {
        let refuse = || {
            Problem::parameter(
                "bbox",
                "bbox is x0,y0,x1,y1 in metres, with x0 < x1 and y0 < y1",
            )
        };
        let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
        match numbers.map_err(|_| refuse())?[..] {
            [x0, y0, x1, y1]
                if x0 < x1 && y0 < y1 && [x0, y0, x1, y1].iter().all(|v| v.is_finite()) =>
            {
                Ok(Self {
                    x: [x0, x1],
                    y: [y0, y1],
                })
            }
            _ => Err(refuse()),
        }
    }
}

impl BoundingBox {
    /// Lowest x, lowest y, highest x, highest y.
    pub(super) fn bounds(&self) -> [f64; 4] {
        [self.x[0], self.y[0], self.x[1], self.y[1]]
    }
}

impl From<BoundingBox> for Within {
    fn from(BoundingBox { x, y }: BoundingBox) -> Self {
        Self { x, y }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_four_finite_numbers_in_order() {
        let good: BoundingBox = "-5,-5.5,20,1e1".parse().unwrap();
        assert_eq!(good.x, [-5.0, 20.0]);
        assert_eq!(good.y, [-5.5, 10.0]);
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,1,4",
            "3,2,1,4",
            "a,b,c,d",
            "nan,0,1,1",
            "0,0,inf,1",
        ] {
            assert!(bad.parse::<BoundingBox>().is_err(), "{bad}");
        }
    }
}
