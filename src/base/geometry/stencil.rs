//! Neighbour offsets on a voxel grid.

/// The 26 neighbours of a voxel, in storage order (k, then j, then i). Entry `n` and entry `25 - n` are opposite.
pub const NEIGHBOURS_26: [[i32; 3]; 26] = {
    let mut out = [[0; 3]; 26];
    let mut n = 0;
    let mut c = 0;
    while c < 27 {
        if c != 13 {
            out[n] = [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1];
            n += 1;
        }
        c += 1;
    }
    out
};

/// The 6 face neighbours, in storage order. Entry `n` and entry `5 - n` are opposite.
pub const NEIGHBOURS_6: [[i32; 3]; 6] = [[0, 0, -1], [0, -1, 0], [-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opposites_pair_up() {
        for n in 0..26 {
            assert_eq!(NEIGHBOURS_26[n], NEIGHBOURS_26[25 - n].map(|c| -c));
        }
        for n in 0..6 {
            assert_eq!(NEIGHBOURS_6[n], NEIGHBOURS_6[5 - n].map(|c| -c));
        }
    }
}
