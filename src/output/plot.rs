//! Curves over logarithmic axes as SVG, told apart by dashes and markers, so that they can be read without colour. Knows nothing of what is plotted.
//!
//! By hand: the small plotting crates for SVG have linear axes, and those with logarithmic ones are large.

use std::fmt::Write as _;

/// A curve of points above 0, with a number each for its dashes and for its markers and colour.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    pub dashes: usize,
    pub markers: usize,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 480.0;
/// The frame: left, right, upper and lower edge.
const FRAME: [f64; 4] = [72.0, 570.0, 40.0, 424.0];
const DASHES: [&str; 4] = ["none", "8 4", "2 3", "10 3 2 3"];
/// Of markers on the dashes of the same number; missing: the curve's colour.
const FILLS: [&str; 2] = ["white", "#cccccc"];
const MIDDLE: &str = " text-anchor=\"middle\"";
/// Okabe and Ito's, of different lightness.
const COLORS: [&str; 4] = ["#000000", "#d55e00", "#0072b2", "#009e73"];

/// The plot as an SVG document.
pub fn log_log(title: &str, [x_name, y_name]: [&str; 2], curves: &[Curve]) -> String {
    let [left, right, top, bottom] = FRAME;
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let x = Axis::over(points().map(|point| point.0), left, right);
    let y = Axis::over(points().map(|point| point.1), bottom, top);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    let (middle_x, middle_y) = (0.5 * (left + right), 0.5 * (top + bottom));
    text(&mut svg, (middle_x, top - 16.0), MIDDLE, title);
    text(&mut svg, (middle_x, HEIGHT - 14.0), MIDDLE, x_name);
    text(&mut svg, (20.0, middle_y), &format!("{MIDDLE} transform=\"rotate(-90 20 {middle_y})\""), y_name);
    for decade in x.first..=x.last {
        let at = x.place_log(f64::from(decade));
        line(&mut svg, (at, top), (at, bottom), "stroke=\"#cccccc\"");
        power(&mut svg, (at, bottom + 20.0), decade);
    }
    for decade in y.first..=y.last {
        let at = y.place_log(f64::from(decade));
        line(&mut svg, (left, at), (right, at), "stroke=\"#cccccc\"");
        power(&mut svg, (left - 20.0, at + 5.0), decade);
    }
    for (number, curve) in curves.iter().enumerate() {
        let (color, dashes) = (COLORS[curve.markers % COLORS.len()], DASHES[curve.dashes % DASHES.len()]);
        let fill = FILLS.get(curve.dashes % DASHES.len()).unwrap_or(&color);
        let style =
            format!("fill=\"none\" stroke=\"{color}\" stroke-width=\"1.6\" stroke-dasharray=\"{dashes}\"");
        let places: Vec<(f64, f64)> = curve.points.iter().map(|p| (x.place(p.0), y.place(p.1))).collect();
        let path: Vec<String> = places.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let _ = writeln!(svg, "<polyline points=\"{}\" {style}/>", path.join(" "));
        let row = top + 12.0 + 22.0 * number as f64;
        line(&mut svg, (right + 14.0, row), (right + 58.0, row), &style);
        for place in places.into_iter().chain([(right + 36.0, row)]) {
            marker(&mut svg, place, curve.markers, (color, fill));
        }
        text(&mut svg, (right + 66.0, row + 4.0), "", &curve.name);
    }
    svg.push_str("</svg>\n");
    svg
}

/// Powers of ten from one edge of the frame to the other.
struct Axis {
    first: i32,
    last: i32,
    from: f64,
    to: f64,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, from: f64, to: f64) -> Axis {
        let (low, high) = values.fold((f64::INFINITY, 0.0), |(low, high), v| (v.min(low), v.max(high)));
        let (low, high) = if low <= high { (low, high) } else { (1.0, 1.0) };
        let first = libm::log10(low).floor() as i32;
        Axis { first, last: (libm::log10(high).ceil() as i32).max(first + 1), from, to }
    }

    fn place(&self, value: f64) -> f64 {
        self.place_log(libm::log10(value))
    }

    fn place_log(&self, log: f64) -> f64 {
        let (first, last) = (f64::from(self.first), f64::from(self.last));
        self.from + (self.to - self.from) * (log - first) / (last - first)
    }
}

fn line(svg: &mut String, (x0, y0): (f64, f64), (x1, y1): (f64, f64), style: &str) {
    let _ = writeln!(svg, "<line x1=\"{x0:.1}\" y1=\"{y0:.1}\" x2=\"{x1:.1}\" y2=\"{y1:.1}\" {style}/>");
}

fn text(svg: &mut String, (x, y): (f64, f64), style: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\"{style}>{text}</text>");
}

fn power(svg: &mut String, (x, y): (f64, f64), of_ten: i32) {
    let raised = format!("10<tspan dy=\"-6\" font-size=\"10\">{of_ten}</tspan>");
    let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\"{MIDDLE}>{raised}</text>");
}

fn marker(svg: &mut String, (x, y): (f64, f64), number: usize, (color, fill): (&str, &str)) {
    let shape =
        ["m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z", "m-4 -4h8v8h-8z", "m0 -5l5 9h-10z", "m0 -6l5 6l-5 6l-5 -6z"];
    let shape = shape[number % shape.len()];
    let _ = writeln!(
        svg,
        "<path d=\"M{x:.1} {y:.1}{shape}\" fill=\"{fill}\" stroke=\"{color}\" stroke-width=\"1.6\"/>"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_where_their_logarithms_do() {
        let axis = Axis::over([20.0, 5000.0].into_iter(), 0.0, 300.0);
        assert_eq!((axis.first, axis.last), (1, 4));
        assert!((axis.place(100.0) - 100.0).abs() < 1e-9);
        let inverted = Axis::over([1.0, 10.0].into_iter(), 400.0, 0.0);
        assert_eq!((inverted.place(1.0), inverted.place(10.0)), (400.0, 0.0));
        // One value, and none.
        assert_eq!(Axis::over([10.0].into_iter(), 0.0, 1.0).last, 2);
        assert_eq!(Axis::over([].into_iter(), 0.0, 1.0).last, 1);
    }

    #[test]
    fn every_element_is_closed_and_every_curve_is_there() {
        let curve = |name: &str, k: usize| Curve {
            name: name.into(),
            points: vec![(1e2, 0.1), (1e5, 30.0)],
            dashes: k,
            markers: k,
        };
        let svg = log_log("a < b & c", ["x", "y"], &[curve("one", 0), curve("two", 1)]);
        assert!(svg.contains("a &lt; b &amp; c"));
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert_eq!(svg.matches("<path").count(), 2 * 3);
        assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
        // Each tag opens an element that is closed elsewhere or closes itself.
        let opened = svg.matches('<').count() - 2 * svg.matches("</").count();
        assert_eq!(opened, svg.matches("/>").count());
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }
}
