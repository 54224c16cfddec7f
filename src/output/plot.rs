//! Curves over linear or logarithmic axes as SVG, told apart by dashes, markers and a name beside each, so that they can be read without colour. Knows nothing of what is plotted.
//!
//! By hand: the small plotting crates for SVG have linear axes, and those with logarithmic ones are large.

use std::fmt::Write as _;

/// A picture of curves over two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub series: Vec<Series>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    pub label: String,
    pub scale: Scale,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    Linear,
    /// Of numbers above 0.
    Log,
}

/// A curve, with a number each for its dashes and for its markers and colour. Points that an axis has no place
/// for (0 on a logarithmic one, NaN) are left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    /// Whether each point is marked by a ring; shorter than the points: the rest is not.
    pub on_front: Vec<bool>,
    pub dashes: usize,
    pub markers: usize,
}

impl Series {
    /// The curve of this number in its plot: those of 24 numbers in a row all look different.
    pub fn new(number: usize, name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        let markers = number % SHAPES.len();
        let dashes = (number + number / SHAPES.len()) % DASHES.len();
        Series { name: name.into(), points, on_front: Vec::new(), dashes, markers }
    }
}

/// The picture's; it grows where names are long.
const WIDTH: f64 = 800.0;
/// Of a name's letter, at most about.
const LETTER: f64 = 7.5;
/// The frame: left, right, upper and lower edge; it grows downwards where there are many names.
const FRAME: [f64; 4] = [72.0, 550.0, 40.0, 424.0];
/// Between the names beside the frame.
const ROW: f64 = 18.0;
const DASHES: [&str; 4] = ["none", "8 4", "2 3", "10 3 2 3"];
/// Circle, square, triangle, diamond, triangle on its tip, cross.
const SHAPES: [&str; 6] = [
    "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
    "m-4 -4h8v8h-8z",
    "m0 -5l5 9h-10z",
    "m0 -6l5 6l-5 6l-5 -6z",
    "m0 5l5 -9h-10z",
    "m-4 -4l8 8m-8 0l8 -8",
];
/// Of markers on the dashes of the same number; missing: the curve's colour.
const FILLS: [&str; 2] = ["white", "#cccccc"];
const MIDDLE: &str = " text-anchor=\"middle\"";
/// Okabe and Ito's, of different lightness.
const COLORS: [&str; 6] = ["#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9"];

/// Which points no other is better than in one number and at least as good in the other, if less is better in both.
pub fn pareto_front(points: &[(f64, f64)]) -> Vec<bool> {
    let beats = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 <= b.1 && (a.0 < b.0 || a.1 < b.1);
    points
        .iter()
        .map(|point| {
            !point.0.is_nan() && !point.1.is_nan() && !points.iter().any(|other| beats(other, point))
        })
        .collect()
}

impl Plot {
    pub fn new(title: &str, x: (&str, Scale), y: (&str, Scale), series: Vec<Series>) -> Self {
        let axis = |(label, scale): (&str, Scale)| Axis { label: label.into(), scale };
        Plot { title: title.into(), x: axis(x), y: axis(y), series }
    }

    /// Marks the points of all curves that are on their common [`pareto_front`].
    pub fn mark_front(&mut self) {
        let points: Vec<(f64, f64)> = self.series.iter().flat_map(|series| series.points.clone()).collect();
        let mut front = pareto_front(&points).into_iter();
        for series in &mut self.series {
            series.on_front = front.by_ref().take(series.points.len()).collect();
        }
    }

    /// The plot as an SVG document.
    pub fn svg(&self) -> String {
        let [left, right, top, bottom] = FRAME;
        let bottom = bottom.max(top + ROW * (self.series.len() + 1) as f64);
        let height = bottom + 56.0;
        let longest = self.series.iter().map(|series| series.name.chars().count()).max().unwrap_or(0);
        let width = WIDTH.max(right + 74.0 + LETTER * longest as f64);
        let points = || self.series.iter().flat_map(|series| &series.points);
        let x = Range::over(points().map(|point| point.0), self.x.scale, left, right);
        let y = Range::over(points().map(|point| point.1), self.y.scale, bottom, top);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"13\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        let (middle_x, middle_y) = (0.5 * (left + right), 0.5 * (top + bottom));
        text(&mut svg, (middle_x, top - 16.0), MIDDLE, &self.title);
        text(&mut svg, (middle_x, height - 14.0), MIDDLE, &self.x.label);
        let turned = format!("{MIDDLE} transform=\"rotate(-90 20 {middle_y})\"");
        text(&mut svg, (20.0, middle_y), &turned, &self.y.label);
        for tick in x.ticks() {
            line(&mut svg, (tick.at, top), (tick.at, bottom), tick.style());
            label(&mut svg, (tick.at, bottom + 20.0), &tick);
        }
        for tick in y.ticks() {
            line(&mut svg, (left, tick.at), (right, tick.at), tick.style());
            label(&mut svg, (left - 24.0, tick.at + 5.0), &tick);
        }
        self.curves(&mut svg, &x, &y);
        svg.push_str("</svg>\n");
        svg
    }

    /// Every curve, and its name beside the frame as near to its last point's height as the others allow.
    fn curves(&self, svg: &mut String, x: &Range, y: &Range) {
        let [_, right, top, _] = FRAME;
        let places: Vec<Vec<(f64, f64, bool)>> =
            self.series.iter().map(|series| places(series, x, y)).collect();
        let ends: Vec<f64> =
            places.iter().map(|places| places.last().map_or(y.from, |&(_, end, _)| end)).collect();
        let rows = spread(&ends, top + 0.5 * ROW, y.from - 0.5 * ROW);
        for ((series, places), row) in self.series.iter().zip(&places).zip(rows) {
            let color = COLORS[series.markers % COLORS.len()];
            let dashes = DASHES[series.dashes % DASHES.len()];
            let fill = FILLS.get(series.dashes % DASHES.len()).unwrap_or(&color);
            let style = format!(
                "fill=\"none\" stroke=\"{color}\" stroke-width=\"1.6\" stroke-dasharray=\"{dashes}\""
            );
            if let Some(&(end_x, end_y, _)) = places.last() {
                line(svg, (end_x, end_y), (right + 14.0, row), "stroke=\"#999999\" stroke-width=\"0.6\"");
            }
            let path: Vec<String> = places.iter().map(|(x, y, _)| format!("{x:.1},{y:.1}")).collect();
            let _ = writeln!(svg, "<polyline points=\"{}\" {style}/>", path.join(" "));
            line(svg, (right + 14.0, row), (right + 58.0, row), &style);
            for &(x, y, on_front) in places {
                if on_front {
                    ring(svg, (x, y));
                }
            }
            for place in places.iter().map(|&(x, y, _)| (x, y)).chain([(right + 36.0, row)]) {
                marker(svg, place, series.markers, (color, fill));
            }
            text(svg, (right + 66.0, row + 4.0), "", &series.name);
        }
        if places.iter().flatten().any(|&(_, _, on_front)| on_front) {
            let row = y.from + 20.0;
            ring(svg, (right + 36.0, row));
            text(svg, (right + 66.0, row + 4.0), "", "on the Pareto front");
        }
    }
}

/// The points that have a place on both axes, and whether each is on the front.
fn places(series: &Series, x: &Range, y: &Range) -> Vec<(f64, f64, bool)> {
    let on_front = series.on_front.iter().copied().chain(std::iter::repeat(false));
    let placed = series.points.iter().zip(on_front);
    placed.filter_map(|(point, on_front)| Some((x.place(point.0)?, y.place(point.1)?, on_front))).collect()
}

/// Moves heights apart until they are [`ROW`] from each other, in their order, between `top` and `bottom`,
/// which must have room for all.
fn spread(heights: &[f64], top: f64, bottom: f64) -> Vec<f64> {
    let mut order: Vec<usize> = (0..heights.len()).collect();
    order.sort_by(|&a, &b| heights[a].total_cmp(&heights[b]));
    let mut rows = heights.to_vec();
    let mut above = top;
    for &i in &order {
        rows[i] = rows[i].max(above);
        above = rows[i] + ROW;
    }
    let mut below = bottom;
    for &i in order.iter().rev() {
        rows[i] = rows[i].min(below);
        below = rows[i] - ROW;
    }
    rows
}

/// What an axis shows, from one edge of the frame to the other: numbers, or their decimal logarithms.
struct Range {
    scale: Scale,
    low: f64,
    high: f64,
    /// Between labelled ticks.
    step: f64,
    from: f64,
    to: f64,
}

struct Tick {
    at: f64,
    /// Ticks without are drawn faintly.
    label: Option<String>,
    /// The label is 10 raised to it.
    is_power: bool,
}

impl Tick {
    fn style(&self) -> &'static str {
        if self.label.is_some() { "stroke=\"#cccccc\"" } else { "stroke=\"#eeeeee\"" }
    }
}

impl Range {
    /// Whole steps around all values: powers of ten, or multiples of 1, 2 or 5 of them.
    fn over(values: impl Iterator<Item = f64>, scale: Scale, from: f64, to: f64) -> Range {
        let (low, high) = values
            .filter_map(|value| Self::coordinate(scale, value))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (v.min(low), v.max(high)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let step = match scale {
            Scale::Log => 1.0,
            // Five steps or some more.
            Scale::Linear if high > low => {
                let least = (high - low) / 8.0;
                let power = libm::pow(10.0, libm::log10(least).floor());
                [1.0, 2.0, 5.0, 10.0].map(|k| k * power).into_iter().find(|&s| s >= least).unwrap_or(power)
            }
            Scale::Linear => 1.0,
        };
        let low = (low / step).floor() * step;
        Range { scale, low, high: ((high / step).ceil() * step).max(low + step), step, from, to }
    }

    fn coordinate(scale: Scale, value: f64) -> Option<f64> {
        match scale {
            Scale::Linear => Some(value),
            Scale::Log => (value > 0.0).then(|| libm::log10(value)),
        }
        .filter(|coordinate| coordinate.is_finite())
    }

    fn place(&self, value: f64) -> Option<f64> {
        Self::coordinate(self.scale, value).map(|coordinate| self.place_coordinate(coordinate))
    }

    fn place_coordinate(&self, coordinate: f64) -> f64 {
        self.from + (self.to - self.from) * (coordinate - self.low) / (self.high - self.low)
    }

    fn ticks(&self) -> Vec<Tick> {
        let steps = ((self.high - self.low) / self.step).round() as u32;
        let is_power = self.scale == Scale::Log;
        let mut ticks = Vec::new();
        for number in 0..=steps {
            let coordinate = self.low + f64::from(number) * self.step;
            if is_power && number < steps && steps <= 4 {
                let between = (2..10).map(|k| coordinate + libm::log10(f64::from(k)));
                ticks.extend(between.map(|c| Tick { at: self.place_coordinate(c), label: None, is_power }));
            }
            // Rid of what adding steps rounds.
            let shown = (coordinate / self.step).round() * self.step;
            let label = Some(format!("{}", (shown * 1e12).round() / 1e12));
            ticks.push(Tick { at: self.place_coordinate(coordinate), label, is_power });
        }
        ticks
    }
}

fn line(svg: &mut String, (x0, y0): (f64, f64), (x1, y1): (f64, f64), style: &str) {
    let _ = writeln!(svg, "<line x1=\"{x0:.1}\" y1=\"{y0:.1}\" x2=\"{x1:.1}\" y2=\"{y1:.1}\" {style}/>");
}

fn text(svg: &mut String, (x, y): (f64, f64), style: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\"{style}>{text}</text>");
}

fn label(svg: &mut String, (x, y): (f64, f64), tick: &Tick) {
    let Some(label) = &tick.label else { return };
    let shown = if tick.is_power {
        format!("10<tspan dy=\"-6\" font-size=\"10\">{label}</tspan>")
    } else {
        label.clone()
    };
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\"{MIDDLE}>{shown}</text>");
}

fn marker(svg: &mut String, (x, y): (f64, f64), number: usize, (color, fill): (&str, &str)) {
    let shape = SHAPES[number % SHAPES.len()];
    let _ = writeln!(
        svg,
        "<path d=\"M{x:.1} {y:.1}{shape}\" fill=\"{fill}\" stroke=\"{color}\" stroke-width=\"1.6\"/>"
    );
}

fn ring(svg: &mut String, (x, y): (f64, f64)) {
    let _ = writeln!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"8.5\" fill=\"none\" stroke=\"#000000\" stroke-width=\"1.2\"/>"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Option<f64>, b: f64) -> bool {
        a.is_some_and(|a| (a - b).abs() < 1e-9)
    }

    #[test]
    fn points_lie_where_their_logarithms_do() {
        let range = Range::over([20.0, 5000.0].into_iter(), Scale::Log, 0.0, 300.0);
        assert_eq!((range.low, range.high), (1.0, 4.0));
        assert!(near(range.place(100.0), 100.0));
        let inverted = Range::over([1.0, 10.0].into_iter(), Scale::Log, 400.0, 0.0);
        assert!(near(inverted.place(1.0), 400.0) && near(inverted.place(10.0), 0.0));
        // One value, and none; nothing where there is no logarithm.
        assert_eq!(Range::over([10.0].into_iter(), Scale::Log, 0.0, 1.0).high, 2.0);
        assert_eq!(Range::over([0.0, -1.0].into_iter(), Scale::Log, 0.0, 1.0).high, 1.0);
        assert_eq!((range.place(0.0), range.place(f64::NAN), range.place(f64::INFINITY)), (None, None, None));
    }

    #[test]
    fn linear_axes_have_round_steps() {
        let range = Range::over([-0.13, 0.38].into_iter(), Scale::Linear, 0.0, 600.0);
        let labels: Vec<String> = range.ticks().into_iter().filter_map(|tick| tick.label).collect();
        assert_eq!(labels, ["-0.2", "-0.1", "0", "0.1", "0.2", "0.3", "0.4"]);
        assert!(near(range.place(0.1), 300.0));
        assert_eq!(Range::over([7.0].into_iter(), Scale::Linear, 0.0, 1.0).high, 8.0);
    }

    #[test]
    fn fronts_hold_what_nothing_beats() {
        let points =
            [(1.0, 4.0), (2.0, 2.0), (2.0, 3.0), (3.0, 2.0), (4.0, 1.0), (1.0, 4.0), (0.5, f64::NAN)];
        assert_eq!(pareto_front(&points), [true, true, false, false, true, true, false]);
    }

    #[test]
    fn names_keep_apart_and_stay_between_the_edges() {
        assert_eq!(spread(&[50.0, 10.0, 52.0], 0.0, 100.0), [50.0, 10.0, 68.0]);
        let rows = spread(&[99.0, 98.0, 97.0], 0.0, 100.0);
        assert_eq!(rows, [100.0, 82.0, 64.0]);
        assert_eq!(spread(&[-5.0, -5.0], 0.0, 100.0), [0.0, 18.0]);
    }

    #[test]
    fn long_names_have_room() {
        let svg = |name: &str| {
            let series = Series::new(0, name, vec![(1.0, 1.0)]);
            Plot::new("", ("", Scale::Log), ("", Scale::Log), vec![series]).svg()
        };
        assert!(svg("independent").contains("viewBox=\"0 0 800 480\""));
        assert!(svg(&"m".repeat(40)).contains("viewBox=\"0 0 924 480\""));
    }

    #[test]
    fn curves_of_24_numbers_look_different() {
        let mut looks: Vec<(usize, usize)> =
            (0..24).map(|k| Series::new(k, "", Vec::new())).map(|s| (s.dashes, s.markers)).collect();
        looks.sort();
        looks.dedup();
        assert_eq!(looks.len(), 24);
    }

    #[test]
    fn every_element_is_closed_and_every_curve_is_there() {
        let points = vec![(1e2, 0.1), (1e5, 30.0), (0.0, 1.0), (1.0, f64::NAN)];
        let worse = vec![(1e3, 0.2)];
        let series = vec![Series::new(0, "one", points), Series::new(7, "two", worse)];
        let mut plot = Plot::new("a < b & c", ("x", Scale::Log), ("y", Scale::Log), series);
        plot.mark_front();
        // What can't be placed may be on the front, but has no ring.
        assert_eq!(plot.series[0].on_front, [true, false, true, false]);
        assert_eq!(plot.series[1].on_front, [false]);
        for y_scale in [Scale::Log, Scale::Linear] {
            plot.y.scale = y_scale;
            let svg = plot.svg();
            assert!(svg.contains("a &lt; b &amp; c"));
            assert_eq!(svg.matches("<polyline").count(), 2);
            assert_eq!(svg.matches("<path").count(), 3 + 2);
            assert_eq!(svg.matches("<circle").count(), 2);
            assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
            // Each tag opens an element that is closed elsewhere or closes itself.
            let opened = svg.matches('<').count() - 2 * svg.matches("</").count();
            assert_eq!(opened, svg.matches("/>").count());
            assert!(!svg.contains("NaN") && !svg.contains("inf"));
        }
    }
}
