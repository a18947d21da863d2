//! The content of a file in f64, and its conversion to a cloud in f32.

use chacha20::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use snake_geometry::Cloud;

/// A position in the file's precision.
pub(crate) type Position = [f64; 3];

/// Points, and the triangles of a mesh.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    pub(crate) points: Vec<Position>,
    /// Indices of points, all in range.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The number of faces in the file that were not read.
    pub(crate) unread_faces: usize,
    /// Sentences for the user about the points.
    pub(crate) notes: Vec<String>,
    /// The position of the sensor, in the file's frame.
    pub(crate) viewpoint: Option<Position>,
}

/// Faces are dominant if at most `MAX_DOMINANT` of them hold more than this share of the surface of at least this many faces,
/// and if their extent is more than `LARGER` times that of the other faces.
const MAX_DOMINANT: usize = 4;
const DOMINANT: (f64, usize) = (0.5, 20);
const LARGER: f64 = 3.0;

/// More samples would fill the memory of most machines.
const MAX_SAMPLES: usize = 100_000_000;

impl Shape {
    /// Refuses faces that refer to missing points.
    pub(crate) fn check_triangles(&self) -> Result<(), String> {
        match self.triangles.as_flattened().iter().find(|&&corner| corner as usize >= self.points.len()) {
            Some(corner) => {
                Err(format!("a face names vertex {corner} (counted from 0), but there are {}", self.points.len()))
            }
            None => Ok(()),
        }
    }

    /// The number of faces in the file.
    pub(crate) fn num_faces(&self) -> usize {
        self.triangles.len() + self.unread_faces
    }

    /// The points as `f32`, relative to an origin if they are far from zero.
    pub(crate) fn into_cloud(self) -> Cloud {
        Cloud::from_positions(self.points.iter().copied())
    }

    /// Samples `number` points on the surface, stratified by area: the area is divided into `number` equal parts, each of
    /// which gets one random point.
    pub(crate) fn sample(&self, number: usize, seed: u64) -> Result<Self, String> {
        if !(1..=MAX_SAMPLES).contains(&number) {
            return Err(format!("{number} samples; 1 to {MAX_SAMPLES} can be drawn"));
        }
        if self.triangles.is_empty() {
            return Err("no faces to draw samples from".into());
        }
        let corners = |triangle: &[u32; 3]| triangle.map(|corner| self.points[corner as usize]);
        let mut total = 0.0;
        let sums: Vec<f64> = self
            .triangles
            .iter()
            .map(|triangle| {
                let area = area(corners(triangle));
                // A triangle with a corner that is not finite has area 0 and gets no points.
                total += if area.is_finite() { area } else { 0.0 };
                total
            })
            .collect();
        if !(total > 0.0 && total.is_finite()) {
            return Err(format!("faces of area {total:e} in all cannot be sampled"));
        }
        let areas = std::iter::zip(&sums, std::iter::once(&0.0).chain(&sums)).map(|(sum, before)| sum - before);
        let notes = self.dominant_faces(areas.map(|area| area / total).collect()).into_iter().collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Rounding can exceed the last sum; the last triangle with an area is then used.
        let last = sums.partition_point(|&sum| sum < total);
        let draw = |piece: usize| {
            let place = (piece as f64 + rng.random::<f64>()) / number as f64 * total;
            let triangle = sums.partition_point(|&sum| sum <= place).min(last);
            let [a, b, c] = corners(&self.triangles[triangle]);
            // The square root makes the distribution uniform over the triangle.
            let (along, across) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            let weights = [1.0 - along, along * (1.0 - across), along * across];
            std::array::from_fn(|axis| weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis])
        };
        let points = (0..number).map(draw).collect();
        Ok(Self { points, notes, ..Self::default() })
    }

    /// A sentence for the user if a few faces hold most of a mesh's surface. `shares` are the triangles' shares of the surface.
    fn dominant_faces(&self, shares: Vec<f64>) -> Option<String> {
        let mut order: Vec<usize> = (0..shares.len()).collect();
        order.sort_by(|&a, &b| shares[b].total_cmp(&shares[a]));
        let held = |number: &usize| order[..*number].iter().map(|&face| shares[face]).sum::<f64>();
        let number = (1..=MAX_DOMINANT.min(order.len())).find(|number| held(number) > DOMINANT.0)?;
        let (large, small) = order.split_at(number);
        let extent = |faces: &[usize]| {
            let corners =
                || faces.iter().flat_map(|&face| self.triangles[face]).map(|corner| self.points[corner as usize]);
            let range = |axis: usize| {
                let [low, high] = corners()
                    .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p[axis]), high.max(p[axis])]);
                high - low
            };
            (0..3).map(range).fold(0.0, f64::max)
        };
        let is_dominant = shares.len() >= DOMINANT.1 && extent(large) > LARGER * extent(small);
        is_dominant.then(|| {
            let percent = 100.0 * held(&number);
            let faces = if number == 1 { "one face holds".into() } else { format!("{number} faces hold") };
            format!("{faces} {percent:.0} % of the mesh's surface, and so of the samples")
        })
    }
}

impl From<Vec<Position>> for Shape {
    fn from(points: Vec<Position>) -> Self {
        Self { points, ..Self::default() }
    }
}

/// Refuses bytes after the last point if every point may have more bytes than the file says: at least one byte per
/// point, and not all zero.
pub(crate) fn check_left_over(rest: &[u8], num_points: usize) -> Result<(), String> {
    if rest.len() >= num_points && rest.iter().any(|&byte| byte != 0) {
        Err(format!(
            "{} bytes are left over after {num_points} points: what the header says does not fit the data; export the file again",
            rest.len()
        ))
    } else {
        Ok(())
    }
}

/// Adds a polygon as a triangle fan.
pub(crate) fn add_polygon(triangles: &mut Vec<[u32; 3]>, corners: &[u32]) {
    if let [first, rest @ ..] = corners {
        triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}

fn area([a, b, c]: [Position; 3]) -> f64 {
    let edge = |to: Position| -> Position { std::array::from_fn(|axis| to[axis] - a[axis]) };
    let (u, v) = (edge(b), edge(c));
    let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    cross.iter().map(|v| v * v).sum::<f64>().sqrt() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of side 2 in the plane z = 1, and a triangle with a quarter of its area in the plane x = 5.
    fn shape() -> Shape {
        let points = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(|[x, y]| [x, y, 1.0]);
        let beside = [[5.0, 0.0, 0.0], [5.0, 2.0, 0.0], [5.0, 0.0, 1.0]];
        let mut triangles = vec![[0, 0, 1], [4, 5, 6]];
        add_polygon(&mut triangles, &[0, 1, 2, 3]);
        Shape { points: [&points[..], &beside].concat(), triangles, ..Shape::default() }
    }

    #[test]
    fn samples_are_even_seeded_and_on_the_surface() {
        let drawn = shape().sample(5000, 1).unwrap().points;
        assert_eq!(drawn, shape().sample(5000, 1).unwrap().points);
        assert_ne!(drawn, shape().sample(5000, 2).unwrap().points);
        let (square, beside): (Vec<&Position>, Vec<&Position>) =
            drawn.iter().partition(|p| (p[2] - 1.0).abs() < 1e-12 && p[0] < 4.0);
        // The areas are 4 to 1, and stratified samples follow them almost exactly.
        assert!(square.len().abs_diff(4000) <= 2 && square.len() + beside.len() == 5000, "{}", square.len());
        assert!(beside.iter().all(|p| (p[0] - 5.0).abs() < 1e-12 && p[1] / 2.0 + p[2] <= 1.0 + 1e-12));
        // Each quarter of the square has 1000 samples within 5 standard deviations.
        for quarter in 0..4 {
            let within = |p: &&&Position| usize::from(p[0] > 1.0) + 2 * usize::from(p[1] > 1.0) == quarter;
            assert!(square.iter().filter(within).count().abs_diff(1000) < 140);
        }
    }

    #[test]
    fn a_face_with_most_of_the_surface_of_many_is_told() {
        let mut many = shape();
        many.triangles = [vec![[4, 5, 6]; 30], vec![[0, 1, 2]]].concat();
        assert!(many.sample(9, 0).unwrap().notes.is_empty());
        many.points[1] = [400.0, 0.0, 1.0];
        let notes = many.sample(9, 0).unwrap().notes;
        assert_eq!(notes, ["one face holds 93 % of the mesh's surface, and so of the samples"]);
        // A large square of two triangles.
        many.points[2] = [400.0, 400.0, 1.0];
        many.points[3] = [0.0, 400.0, 1.0];
        many.triangles.push([0, 2, 3]);
        let notes = many.sample(9, 0).unwrap().notes;
        assert_eq!(notes, ["2 faces hold 100 % of the mesh's surface, and so of the samples"]);
        many.triangles.truncate(12);
        many.triangles.push([0, 1, 2]);
        assert!(many.sample(9, 0).unwrap().notes.is_empty(), "few faces");
    }

    #[test]
    fn surfaces_that_cannot_be_sampled_are_refused() {
        assert!(Shape::from(vec![[0.0; 3]; 3]).sample(5, 0).unwrap_err().contains("no faces"));
        assert!(shape().sample(0, 0).is_err() && shape().sample(usize::MAX, 0).is_err());
        let degenerate = Shape { triangles: vec![[0, 0, 1]], ..shape() };
        assert!(degenerate.sample(5, 0).unwrap_err().contains("of area 0e0"));
        let mut broken = shape();
        broken.points[0][0] = f64::NAN;
        let drawn = broken.sample(100, 0).unwrap().points;
        assert!(drawn.iter().all(|p| p.iter().all(|v| v.is_finite()) && p[0] > 4.9), "only the whole triangle is left");
    }
}
