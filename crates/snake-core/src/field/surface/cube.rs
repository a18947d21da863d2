//! The triangles of one cell for each of the 256 cases of occupied corners.

/// An edge of the cell: its lower corner and its axis. Bits 0, 1, 2 of a corner are its place along x, y, z.
pub(super) type CubeEdge = (usize, usize);

/// The triangles of each case, as triples of crossed edges, counterclockwise seen from the empty side. Bit c of a case
/// is set if corner c is occupied.
///
/// This is marching cubes (Lorensen and Cline, SIGGRAPH 1987) by rules instead of a table. On each face of the cell the
/// crossings are connected so that occupied corners are never separated. The neighbouring cell uses the same rule, so
/// surfaces have no holes and thin shells do not tear. A fan of triangles fills each loop. Its apex is chosen so that
/// no inner edge lies on a face, where the neighbouring cell could have the same edge.
pub(super) fn triangles() -> [Vec<[CubeEdge; 3]>; 256] {
    std::array::from_fn(|case| loops(case).iter().flat_map(|polygon| fan(polygon)).collect())
}

/// The four corners of each face, counterclockwise seen from outside the cell.
fn faces() -> [[usize; 4]; 6] {
    std::array::from_fn(|face| {
        let (axis, side) = (face / 2, face % 2);
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        let base = side << axis;
        let ring = [base, base | u, base | u | v, base | v];
        if side == 1 { ring } else { [ring[3], ring[2], ring[1], ring[0]] }
    })
}

fn edge(a: usize, b: usize) -> CubeEdge {
    (a.min(b), (a ^ b).trailing_zeros() as usize)
}

/// The closed loops of crossings on the faces of the cell.
fn loops(case: usize) -> Vec<Vec<CubeEdge>> {
    let occupied = |corner: usize| case >> corner & 1 == 1;
    // Each crossing leads to the next: on a face, the surface goes from the end of a run of empty corners to its start.
    let mut segments: Vec<(CubeEdge, CubeEdge)> = Vec::new();
    for ring in faces() {
        let corner = |i: usize| ring[i % 4];
        for start in 0..4 {
            if occupied(corner(start)) && !occupied(corner(start + 1)) {
                let end = (start + 1..start + 4).find(|&i| occupied(corner(i + 1))).unwrap_or(start);
                segments.push((edge(corner(end), corner(end + 1)), edge(corner(start), corner(start + 1))));
            }
        }
    }
    segments.sort_unstable();
    let mut loops = Vec::new();
    while let Some((first, mut next)) = segments.pop() {
        let mut polygon = vec![first];
        while let Some(index) = segments.iter().position(|&(from, _)| from == next) {
            polygon.push(next);
            next = segments.remove(index).1;
        }
        loops.push(polygon);
    }
    loops
}

fn fan(polygon: &[CubeEdge]) -> Vec<[CubeEdge; 3]> {
    let number = polygon.len();
    let at = |i: usize| polygon[i % number];
    let stays_inside = |&apex: &usize| (2..number - 1).all(|i| !on_one_face(at(apex), at(apex + i)));
    let apex = (0..number).find(stays_inside).unwrap_or(0);
    (1..number - 1).map(|i| [at(apex), at(apex + i), at(apex + i + 1)]).collect()
}

fn on_one_face(a: CubeEdge, b: CubeEdge) -> bool {
    (0..3).any(|axis| axis != a.1 && axis != b.1 && (a.0 ^ b.0) >> axis & 1 == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_crossing_is_used_and_inner_edges_keep_off_the_faces() {
        for (case, triangles) in triangles().iter().enumerate() {
            let edges = (0..3).flat_map(|axis| (0..8).map(move |corner| (corner, axis)));
            for (corner, axis) in edges.filter(|(corner, axis)| corner >> axis & 1 == 0) {
                let crossed = (case >> corner & 1) != (case >> (corner | 1 << axis) & 1);
                let used = triangles.iter().flatten().any(|&edge| edge == (corner, axis));
                assert_eq!(crossed, used, "{case:08b} {corner} {axis}");
            }
            // An edge inside the cell belongs to two of its triangles, an edge on a face to one.
            for (t, i) in (0..triangles.len()).flat_map(|t| (0..3).map(move |i| (t, i))) {
                let (from, to) = (triangles[t][i], triangles[t][(i + 1) % 3]);
                let back =
                    triangles.iter().filter(|other| (0..3).any(|j| (other[j], other[(j + 1) % 3]) == (to, from)));
                assert_eq!(back.count(), usize::from(!on_one_face(from, to)), "{case:08b} {from:?} {to:?}");
            }
        }
    }
}
