//! Plots as SVG, drawn with the classes of the report's style sheet.

use glam::DVec2;

/// Width of every plot in its own units; the page scales it.
const WIDTH: f64 = 920.0;
/// Room for labels around a plot.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 44.0;
/// Points of a curve: more than this are averaged over.
const MOST_POINTS: usize = 900;

/// A curve through points, in the plot's own axes.
pub(crate) struct Curve {
    /// For the legend.
    pub(crate) name: &'static str,
    /// Class of the style sheet.
    pub(crate) class: &'static str,
    pub(crate) points: Vec<DVec2>,
    /// Whether its start and end are marked.
    pub(crate) ends: bool,
}

/// Values over frames, stacked in the order given. `None` leaves a gap.
pub(crate) struct Layer {
    pub(crate) name: String,
    pub(crate) class: String,
    pub(crate) values: Vec<Option<f64>>,
}

/// A range of an axis, and where its pixels are.
struct Axis {
    lo: f64,
    hi: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn at(&self, value: f64) -> f64 {
        self.from + (value - self.lo) / (self.hi - self.lo) * (self.to - self.from)
    }
}

/// Round values within a range, about `wanted` of them, and their number of decimals.
fn ticks(lo: f64, hi: f64, wanted: f64) -> (Vec<f64>, usize) {
    let rough = (hi - lo) / wanted;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough * 0.999).unwrap_or(rough);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (lo / step - 1e-9).ceil() as i64;
    let last = (hi / step + 1e-9).floor() as i64;
    ((first..=last).map(|i| i as f64 * step).collect(), decimals)
}

/// The axes with their ticks and names, as a frame for what is drawn in it.
fn axes(svg: &mut String, x: &Axis, y: &Axis, names: [&str; 2]) {
    let label = |svg: &mut String, class: &str, x: f64, y: f64, text: &str| {
        *svg += &format!("<text class='{class}' x='{x:.1}' y='{y:.1}'>{text}</text>");
    };
    let density = |axis: &Axis, pixels: f64| ((axis.to - axis.from).abs() / pixels).max(2.0);
    let (values, decimals) = ticks(x.lo, x.hi, density(x, 90.0));
    for value in values {
        let at = x.at(value);
        *svg += &format!("<path class='grid' d='M{at:.1} {:.1}V{:.1}'/>", y.from, y.to);
        label(svg, "tick middle", at, y.from + 16.0, &format!("{:.decimals$}", value + 0.0));
    }
    let (values, decimals) = ticks(y.lo, y.hi, density(y, 45.0));
    for value in values {
        let at = y.at(value);
        *svg += &format!("<path class='grid' d='M{:.1} {at:.1}H{:.1}'/>", x.from, x.to);
        label(svg, "tick end", x.from - 7.0, at + 4.0, &format!("{:.decimals$}", value + 0.0));
    }
    label(svg, "axis middle", 0.5 * (x.from + x.to), y.from + 36.0, names[0]);
    let (at_x, at_y) = (x.from - 48.0, 0.5 * (y.from + y.to));
    *svg += &format!(
        "<text class='axis middle' transform='translate({at_x:.1} {at_y:.1}) rotate(-90)'>{}</text>",
        names[1]
    );
}

fn open(width: f64, height: f64, description: &str) -> String {
    format!("<svg viewBox='0 0 {width:.0} {height:.0}' role='img' aria-label='{description}'>")
}

/// Curves in a plane, with one scale for both axes.
pub(crate) fn plane(curves: &[Curve], names: [&str; 2], width: f64, height: f64) -> String {
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let Some(first) = points().next() else { return String::new() };
    let (lo, hi) = points().fold((*first, *first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let size = DVec2::new(width - LEFT - RIGHT, height - TOP - BOTTOM);
    // A trajectory of millimetres is shown as the point that it is.
    let extent = (hi - lo).max(DVec2::splat(0.02)) * 1.12;
    let scale = (extent / size).max_element();
    let (middle, half) = (0.5 * (lo + hi), 0.5 * scale * size);
    let x = Axis { lo: middle.x - half.x, hi: middle.x + half.x, from: LEFT, to: width - RIGHT };
    let y = Axis { lo: middle.y - half.y, hi: middle.y + half.y, from: height - BOTTOM, to: TOP };
    let mut svg = open(width, height, &format!("{} over {}", names[1], names[0]));
    axes(&mut svg, &x, &y, names);
    for curve in curves {
        svg += &format!("<path class='line {}' d='{}'/>", curve.class, path(&curve.points, &x, &y));
        if let (true, Some(start), Some(end)) = (curve.ends, curve.points.first(), curve.points.last()) {
            svg += &format!(
                "<circle class='start' cx='{:.1}' cy='{:.1}' r='5'/><rect class='stop' x='{:.1}' y='{:.1}' width='9' height='9'/>",
                x.at(start.x),
                y.at(start.y),
                x.at(end.x) - 4.5,
                y.at(end.y) - 4.5
            );
        }
    }
    svg + "</svg>"
}

/// Curves over a quantity, both axes from 0.
pub(crate) fn over(curves: &[Curve], names: [&str; 2], height: f64) -> String {
    let most = curves.iter().flat_map(|curve| &curve.points).fold(DVec2::ZERO, |most, p| most.max(*p));
    if most.min_element() <= 0.0 {
        return String::new();
    }
    let most = 1.05 * most;
    let x = Axis { lo: 0.0, hi: most.x, from: LEFT, to: WIDTH - RIGHT };
    let y = Axis { lo: 0.0, hi: most.y, from: height - BOTTOM, to: TOP };
    let mut svg = open(WIDTH, height, &format!("{} over {}", names[1], names[0]));
    axes(&mut svg, &x, &y, names);
    for curve in curves {
        svg += &format!("<path class='line {}' d='{}'/>", curve.class, path(&curve.points, &x, &y));
    }
    svg + "</svg>"
}

fn path(points: &[DVec2], x: &Axis, y: &Axis) -> String {
    let mut path = String::new();
    for (i, p) in points.iter().enumerate() {
        let command = if i == 0 { 'M' } else { 'L' };
        path += &format!("{command}{:.1} {:.1}", x.at(p.x), y.at(p.y));
    }
    path
}

/// Averages runs of neighbouring values, so that at most [`MOST_POINTS`] remain; returns them with the length of a run.
fn thinned(values: &[Option<f64>]) -> (Vec<Option<f64>>, usize) {
    let run = values.len().div_ceil(MOST_POINTS).max(1);
    let mean = |values: &[Option<f64>]| {
        let (sum, n) = values.iter().flatten().fold((0.0, 0), |(sum, n), v| (sum + v, n + 1));
        (n > 0).then(|| sum / f64::from(n))
    };
    (values.chunks(run).map(mean).collect(), run)
}

/// What [`over_frames`] draws.
pub(crate) struct OverFrames<'a> {
    /// Number of the first frame.
    pub(crate) first: u64,
    /// Areas on top of each other, the first at the bottom.
    pub(crate) stacked: &'a [Layer],
    /// Lines in front of them.
    pub(crate) lines: &'a [Layer],
    /// Bands of frames behind them: class, first frame, number of frames (by their place, from 0).
    pub(crate) bands: &'a [(&'static str, usize, usize)],
    /// A strip along the top, likewise.
    pub(crate) strip: &'a [(&'static str, usize, usize)],
    /// Name of the y axis.
    pub(crate) name: &'a str,
    /// Top of the y axis; what is higher is cut off.
    pub(crate) top: f64,
    pub(crate) height: f64,
}

/// Values over frames.
pub(crate) fn over_frames(plot: &OverFrames<'_>) -> String {
    let layers = || plot.stacked.iter().chain(plot.lines);
    let frames = layers().map(|layer| layer.values.len()).max().unwrap_or(0);
    if frames == 0 {
        return String::new();
    }
    let first = plot.first as f64;
    let x = Axis { lo: first, hi: first + (frames.max(2) - 1) as f64, from: LEFT, to: WIDTH - RIGHT };
    let y = Axis { lo: 0.0, hi: plot.top, from: plot.height - BOTTOM, to: TOP };
    let mut svg = open(WIDTH, plot.height, plot.name);
    let band = |svg: &mut String, kind: &str, (class, start, length): &(&str, usize, usize), top: f64, height: f64| {
        let (from, to) = (first + *start as f64 - 0.5, first + (start + length) as f64 - 0.5);
        let (from, to) = (x.at(from).max(x.from), x.at(to).min(x.to));
        let width = (to - from).max(0.5);
        *svg += &format!(
            "<rect class='{kind} {class}' x='{from:.1}' y='{top:.1}' width='{width:.1}' height='{height:.1}'/>"
        );
    };
    for run in plot.bands {
        band(&mut svg, "band", run, y.to, y.from - y.to);
    }
    for run in plot.strip {
        band(&mut svg, "verdict", run, y.to - 9.0, 6.0);
    }
    axes(&mut svg, &x, &y, ["frame", plot.name]);
    let height = |value: f64| y.at(value.min(plot.top));
    let mut base: Vec<f64> = Vec::new();
    for layer in plot.stacked {
        let (values, run) = thinned(&layer.values);
        base.resize(values.len(), 0.0);
        let at = |i: usize| x.at(first + (i * run) as f64);
        let mut area = String::new();
        for (i, (value, base)) in values.iter().zip(&base).enumerate() {
            let command = if i == 0 { 'M' } else { 'L' };
            area += &format!("{command}{:.1} {:.1}", at(i), height(base + value.unwrap_or(0.0)));
        }
        for (i, base) in base.iter().enumerate().rev() {
            area += &format!("L{:.1} {:.1}", at(i), height(*base));
        }
        svg += &format!("<path class='area {}' d='{area}Z'/>", layer.class);
        base.iter_mut().zip(&values).for_each(|(base, value)| *base += value.unwrap_or(0.0));
    }
    for layer in plot.lines {
        let (values, run) = thinned(&layer.values);
        let mut line = String::new();
        let mut drawn = false;
        for (i, value) in values.iter().enumerate() {
            if let Some(value) = value {
                let command = if drawn { 'L' } else { 'M' };
                line += &format!("{command}{:.1} {:.1}", x.at(first + (i * run) as f64), height(*value));
            }
            drawn = value.is_some();
        }
        svg += &format!("<path class='line {}' d='{line}'/>", layer.class);
    }
    svg + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_range() {
        let (values, decimals) = ticks(-0.13, 0.42, 5.0);
        assert_eq!(decimals, 1);
        let rounded: Vec<String> = values.iter().map(|v| format!("{:.1}", v + 0.0)).collect();
        assert_eq!(rounded, ["0.0", "0.2", "0.4"]);
        assert_eq!(ticks(0.0, 100.0, 4.0), (vec![0.0, 50.0, 100.0], 0));
        assert_eq!(ticks(3.0, 3.04, 4.0).1, 2);
    }

    #[test]
    fn thinning_keeps_means_and_gaps() {
        let (values, run) = thinned(&vec![Some(2.0); 5 * MOST_POINTS]);
        assert_eq!((values.len(), run, values[7]), (MOST_POINTS, 5, Some(2.0)));
        assert_eq!(thinned(&[None, Some(1.0)]), (vec![None, Some(1.0)], 1));
        assert_eq!(thinned(&[]).0, []);
    }

    #[test]
    fn equal_lengths_are_equal_on_both_axes() {
        let points = vec![DVec2::new(0.0, 0.0), DVec2::new(1.0, 0.0), DVec2::new(1.0, 1.0)];
        let curve = Curve { name: "path", class: "estimate", points, ends: false };
        let svg = plane(&[curve], ["x", "y"], 500.0, 400.0);
        let path = svg.split("estimate' d='M").nth(1).unwrap().split('\'').next().unwrap();
        let numbers: Vec<f64> = path.split(['L', ' ']).map(|n| n.parse().unwrap()).collect();
        let (along_x, along_y) = (numbers[2] - numbers[0], numbers[3] - numbers[5]);
        assert!(along_x > 50.0 && (along_x - along_y).abs() < 0.2, "{numbers:?}");
    }

    #[test]
    fn nothing_to_plot_is_no_plot() {
        assert_eq!(plane(&[], ["x", "y"], 10.0, 10.0), "");
        let plot = OverFrames {
            first: 0,
            stacked: &[],
            lines: &[],
            bands: &[],
            strip: &[],
            name: "ms",
            top: 1.0,
            height: 100.0,
        };
        assert_eq!(over_frames(&plot), "");
    }
}
