//! What was asked for, as plain validated values that every room may use.

use serde::{Deserialize, Serialize};

/// What the image depends on beside the scene: with the scene these decide every byte.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageSettings {
    /// Pixels, 1 ..= 65536 each.
    pub width: u32,
    pub height: u32,
    /// The part that is rendered; the whole image by default.
    pub crop: Crop,
    /// Samples per pixel, 1 ..= 65536. One sample is taken at the pixel's centre.
    pub spp: u32,
    pub seed: u64,
    pub integrator: Integrator,
    /// Bounces after the eye ray; what lies beyond contributes nothing.
    pub max_depth: u32,
    /// A branch whose throughput is below this in every channel ends; 0 ends none. Not used by paths.
    pub min_weight: f64,
    /// Bounces after which a path may end by chance (Russian roulette), which changes no mean.
    pub roulette: u32,
    /// How paths find lights.
    pub direct: Direct,
    /// How good each part of the image must become, by at most `spp` samples; else all pixels get as many.
    pub error_target: Option<ErrorTarget>,
    /// Whether variances of pixels are to be known.
    pub variance: bool,
    /// Whether it is to be known what the first surfaces are.
    pub features: bool,
    pub sampler: SamplerKind,
    pub filter: Filter,
    pub encoding: Encoding,
    pub show: Show,
}

impl Default for ImageSettings {
    fn default() -> Self {
        ImageSettings::sized(512, 512)
    }
}

impl ImageSettings {
    pub const ROULETTE: u32 = 4;

    /// The defaults for a whole image of this size in pixels.
    pub fn sized(width: u32, height: u32) -> Self {
        ImageSettings {
            width,
            height,
            crop: Crop { x0: 0, y0: 0, x1: width, y1: height },
            spp: 1,
            seed: 0,
            integrator: Integrator::Whitted,
            max_depth: 8,
            min_weight: 0.0,
            roulette: Self::ROULETTE,
            direct: Direct::Both,
            error_target: None,
            variance: false,
            features: false,
            sampler: SamplerKind::Sobol,
            filter: Filter::Box,
            encoding: Encoding::Srgb,
            show: Show::Scene,
        }
    }
}

/// An error that is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorTarget {
    pub metric: ErrorMetric,
    /// > 0.
    pub value: f64,
}

/// How errors are measured against what infinitely many samples would show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum ErrorMetric {
    /// Root mean square error of linear values.
    #[default]
    Rmse,
    /// Relative mean square error: each square over that of the value itself, plus 0.01.
    Relmse,
    /// Root mean square error of sRGB display values from 0 to 1.
    Display,
}

/// Pixels x0 <= x < x1, y0 <= y < y1; row 0 is on top.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crop {
    pub x0: u32,
    pub y0: u32,
    pub x1: u32,
    pub y1: u32,
}

impl Crop {
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }

    pub fn height(&self) -> u32 {
        self.y1 - self.y0
    }
}

/// How light is carried from lights to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// Local illumination, shadows, mirror and refraction rays (Whitted 1980).
    Whitted,
    /// Paths with next-event estimation: all that light does between surfaces (Kajiya 1986; Veach 1997).
    Path,
}

impl Integrator {
    /// Bounces that are followed unless something else is asked for: of paths all that matter, as Russian roulette ends them.
    pub fn max_depth(self) -> u32 {
        match self {
            Integrator::Whitted => 8,
            Integrator::Path => 1000,
        }
    }
}

/// How paths find lights that have an extent. All have the same mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Direct {
    /// By both of the others, weighted by the power heuristic (multiple importance sampling; Veach and Guibas 1995).
    #[default]
    Both,
    /// By choosing points on lights.
    Light,
    /// By where bounces happen to go.
    Bsdf,
}

/// The numbers that samples are made of: each a function of seed, pixel, sample, path and dimension.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum SamplerKind {
    /// Independent random numbers.
    Independent,
    /// Jittered cells, in pairs of dimensions (Kensler 2013, "Correlated Multi-Jittered Sampling").
    Stratified,
    /// Owen-scrambled Sobol points (Burley 2020), scrambled anew for each pixel.
    #[default]
    Sobol,
    /// One such sequence along a Morton curve through all pixels: the error is spread like blue noise (Ahmed and Wonka 2020).
    Blue,
}

/// The pixel filter that samples are distributed by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// The pixel's square.
    Box,
    /// A pyramid of radius 1 pixel.
    Tent,
    /// Standard deviation 0.5 pixels, cut at radius 1.5.
    Gaussian,
    /// Mitchell and Netravali 1988, B = C = 1/3, radius 2.
    Mitchell,
}

/// How linear values become the integers of a display format (PNG). EXR and PFM are always linear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// The piecewise sRGB curve (IEC 61966-2-1), what viewers expect.
    #[default]
    Srgb,
    /// No curve.
    Linear,
}

/// What is seen of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Show {
    /// All of it.
    #[default]
    Scene,
    /// The bounding sphere of each object, in the colour of its material, but for those around the camera.
    Bounds,
}

/// How the image is computed: nothing here but a time limit changes a byte of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    pub accel: AccelKind,
    pub build: BuildSettings,
    pub split: Split,
    pub within: Within,
    /// Edge of a tile in pixels, 1 ..= 4096.
    pub tile_size: u32,
    /// How a split that deals all pixels at once does so.
    pub deal: Deal,
    /// Bytes that each rank gives to rays under way where they travel.
    pub ray_memory: u64,
    /// Bytes that each rank gives to copies of hot blocks where it has a part of the scene by place.
    pub replicate_hot: Option<u64>,
    /// Seconds of tracing after which no more samples are begun: the one thing here that changes the image.
    pub time_limit: Option<f64>,
}

impl RunSettings {
    /// Enough for a million rays.
    pub const RAY_MEMORY: u64 = 256 << 20;
    /// What the program gives to copies of hot blocks unless told otherwise: small scenes are copied whole.
    pub const REPLICATE_HOT: u64 = 32 << 20;
    const TILE_SIZE: u32 = 32;

    /// The edge of tiles that are many enough to be dealt to all, and large enough to be worth it: measured, single samples of 32 x 32 pixels take up to an eighth longer than those of 64 x 64.
    pub fn tile_size_for(image: &ImageSettings) -> u32 {
        let Crop { x0, y0, x1, y1 } = image.crop;
        let pixels = u64::from(x1 - x0) * u64::from(y1 - y0);
        if image.spp == 1 && pixels >= 1 << 20 { 2 * Self::TILE_SIZE } else { Self::TILE_SIZE }
    }
}

impl Default for RunSettings {
    fn default() -> Self {
        RunSettings {
            accel: AccelKind::Bvh,
            build: BuildSettings::default(),
            split: Split::Tiles,
            within: Within::Rays,
            tile_size: RunSettings::TILE_SIZE,
            deal: Deal::default(),
            ray_memory: RunSettings::RAY_MEMORY,
            replicate_hot: None,
            time_limit: None,
        }
    }
}

/// The structure that finds hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum AccelKind {
    /// A bounding volume hierarchy.
    Bvh,
    /// A uniform grid.
    Grid,
    /// A bounding sphere around each object, of which then everything is tested.
    Spheres,
    /// Every primitive is tested: a check, not a way to render.
    Brute,
}

/// How structures are built.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BuildSettings {
    /// Of the hierarchy.
    pub preset: BuildPreset,
    /// Cells of the grid for each primitive, above 0.
    pub grid_density: f64,
}

impl BuildSettings {
    /// Measured: coarser grids test far more primitives where a scene is uneven, finer ones gain little where it is even.
    pub const GRID_DENSITY: f64 = 4.0;
}

impl From<BuildPreset> for BuildSettings {
    fn from(preset: BuildPreset) -> Self {
        BuildSettings { preset, grid_density: Self::GRID_DENSITY }
    }
}

impl Default for BuildSettings {
    fn default() -> Self {
        BuildPreset::default().into()
    }
}

/// How much time the building of the hierarchy is given, so that tracing takes less.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum BuildPreset {
    /// For an image of few rays.
    Fast,
    /// For most images.
    #[default]
    Balanced,
    /// For images of very many rays.
    Best,
}

/// How the image is divided among ranks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Rank 0 deals screen tiles on demand, the costliest first.
    Tiles,
    /// The stream of camera rays in Morton order is dealt to all ranks at once, and nobody speaks until all is done.
    Stream,
    /// Each rank has an equal number of primitives, and every ray asks every rank.
    Triangles,
    /// Each rank has what lies in its voxels, and rays travel to the ranks whose voxels they come through.
    Voxels,
}

impl Split {
    /// Whether each rank has a part of the scene only.
    pub fn is_partitioned(self) -> bool {
        matches!(self, Split::Triangles | Split::Voxels)
    }
}

/// How pixels, tile by tile along a Morton curve, are dealt to ranks at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Deal {
    /// By turns.
    #[default]
    Interleaved,
    /// To each rank an unbroken run.
    Blocks,
}

/// How a rank's threads divide what the rank has to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Within {
    /// Each has tiles of its own, and all primitives.
    Rays,
    /// Each has a part of the primitives, and all rays: batch by batch they are put to all parts at once.
    Triangles,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_of_single_samples_are_larger_where_there_are_enough() {
        let of = |width, spp| {
            RunSettings::tile_size_for(&ImageSettings { spp, ..ImageSettings::sized(width, 1024) })
        };
        assert_eq!([of(1024, 1), of(1023, 1), of(1024, 2)], [64, 32, 32]);
        let part = Crop { x0: 0, y0: 0, x1: 64, y1: 64 };
        let image = ImageSettings { crop: part, ..ImageSettings::sized(4096, 4096) };
        assert_eq!(RunSettings::tile_size_for(&image), RunSettings::default().tile_size);
    }
}
