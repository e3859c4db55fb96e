//! Few colours that stand for all of a picture's: what makes its file small.

use super::shape::Rgb;

/// Bits of each colour that tell colours apart.
const BITS: u32 = 6;

/// Colours of a picture that look alike.
#[derive(Clone, Copy)]
struct Alike {
    key: usize,
    count: f64,
    mean: [f64; 3],
}

/// A group of colours, which becomes one.
struct ColourGroup {
    colours: Vec<Alike>,
    mean: [f64; 3],
    /// Sum of squared differences from the mean, by channel.
    spread: [f64; 3],
}

impl ColourGroup {
    fn of(colours: Vec<Alike>) -> Self {
        let count: f64 = colours.iter().map(|c| c.count).sum();
        let sum = |f: &dyn Fn(&Alike) -> f64| colours.iter().map(|c| c.count * f(c)).sum::<f64>();
        let mean = [0, 1, 2].map(|a| sum(&|c| c.mean[a]) / count.max(1.0));
        let spread = [0, 1, 2].map(|a| sum(&|c| (c.mean[a] - mean[a]).powi(2)));
        Self { colours, mean, spread }
    }

    fn total(&self) -> f64 {
        self.spread.iter().sum()
    }

    /// In two at the mean of the channel that spreads most.
    fn halves(self) -> [Self; 2] {
        let [r, g, b] = self.spread;
        let a = if r >= g && r >= b { 0 } else { 1 + usize::from(b > g) };
        let (low, high) = self.colours.into_iter().partition(|c| c.mean[a] <= self.mean[a]);
        [low, high].map(Self::of)
    }
}

/// The colours of a picture in at most 256, and which of them stands for each.
pub(super) struct Palette {
    colours: Vec<Rgb>,
    /// Place in the colours, by what tells colours apart.
    places: Vec<u8>,
}

impl Palette {
    /// At most `most` (1 to 256) colours: the group that spreads most is halved until there are so many. A picture of
    /// fewer colours that differ by more than 3 levels keeps them as they are.
    pub(super) fn of(pixels: &[Rgb], most: usize) -> Self {
        let mut counts = vec![[0u32; 4]; 1 << (3 * BITS)];
        for p in pixels {
            let bin = &mut counts[key(p)];
            bin[0] += 1;
            (0..3).for_each(|a| bin[a + 1] += u32::from(p[a]));
        }
        let alike = |(key, [n, r, g, b]): (usize, &[u32; 4])| {
            let mean = [r, g, b].map(|sum| f64::from(*sum) / f64::from((*n).max(1)));
            Alike { key, count: f64::from(*n), mean }
        };
        let all: Vec<Alike> = counts.iter().enumerate().filter(|(_, bin)| bin[0] > 0).map(alike).collect();
        let mut groups = vec![ColourGroup::of(all)];
        while groups.len() < most.min(256) {
            let widest = (0..groups.len()).max_by(|&a, &b| groups[a].total().total_cmp(&groups[b].total()));
            let Some(widest) = widest.filter(|&n| groups[n].colours.len() > 1 && groups[n].total() > 0.0) else {
                break;
            };
            let halves = groups.swap_remove(widest).halves();
            groups.extend(halves);
        }
        let mut places = vec![0; counts.len()];
        for (n, group) in groups.iter().enumerate() {
            group.colours.iter().for_each(|c| places[c.key] = n as u8);
        }
        Self { colours: groups.iter().map(|g| g.mean.map(|v| (v + 0.5) as u8)).collect(), places }
    }

    /// All colours, one after the other.
    pub(super) fn bytes(&self) -> Vec<u8> {
        self.colours.concat()
    }

    /// Place of the colour that stands for a pixel of the picture.
    pub(super) fn place(&self, pixel: &Rgb) -> u8 {
        self.places[key(pixel)]
    }
}

/// What tells colours apart.
fn key(p: &Rgb) -> usize {
    p.iter().fold(0, |key, v| key << BITS | usize::from(v >> (8 - BITS)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(palette: &Palette, pixel: Rgb) -> Rgb {
        palette.colours[usize::from(palette.place(&pixel))]
    }

    #[test]
    fn few_colours_stay_as_they_are() {
        let pixels: Vec<Rgb> = (0..200u8).map(|n| [n / 40 * 50, 255 - n / 20 * 20, 7]).collect();
        let palette = Palette::of(&pixels, 256);
        assert!(pixels.iter().all(|p| shown(&palette, *p) == *p));
        assert_eq!(Palette::of(&[], 256).bytes().len(), 3);
    }

    #[test]
    fn many_colours_come_close_and_a_rare_one_that_stands_out_is_kept() {
        let grey = |n: usize| [(n % 251) as u8, ((n / 3) % 251) as u8, ((n / 7) % 120) as u8];
        let mut pixels: Vec<Rgb> = (0..60_000).map(grey).collect();
        pixels.extend([[255, 0, 255]; 40]);
        let palette = Palette::of(&pixels, 256);
        assert_eq!(palette.bytes().len(), 3 * 256);
        let off =
            |p: &Rgb| p.iter().zip(shown(&palette, *p)).map(|(a, b)| f64::from(a.abs_diff(b)).powi(2)).sum::<f64>();
        let mean = (pixels.iter().map(off).sum::<f64>() / pixels.len() as f64).sqrt();
        assert!(mean < 22.0, "{mean}");
        assert!(off(&[255, 0, 255]) < 40.0, "{:?}", shown(&palette, [255, 0, 255]));
    }
}
