//! What images are measured against: one of very many samples, whose own error is known, and which may be kept in a folder.

use std::path::{Path, PathBuf};

use bytemuck::cast_slice;

use super::stage::Stage;
use crate::error::{Error, Result};
use crate::image::{Image, Layer};
use crate::lab::ladder::textbook::Precision;
use crate::output::compare::RELATIVE_EPSILON;
use crate::output::write::{self, Format, Target, WriteOptions};
use crate::output::{metadata, read};
use crate::scene::Scene;
use crate::settings::{Encoding, ImageSettings, SamplerKind};
use crate::wire;

/// Independent renders that the reference is the mean of. Their spread tells its error whatever the sampler; batches of one render would say too much of samples that are
/// spread evenly, and what is subtracted from other errors must not be too much.
pub const PARTS: u32 = 4;
/// Of the parts; nobody measures with these.
const SEED: u64 = 0x7265_6665_7265_6e63;
/// Samples per pixel where time decides: powers of two.
const LEAST: u32 = 64;
const MOST: u32 = 4096;

/// How good a reference is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quality {
    /// Samples per pixel, 2 * [`PARTS`] or more.
    Samples(u32),
    /// About as many as can be taken in so many seconds: 64 to 4096.
    Seconds(f64),
}

/// Where references of one scene are kept.
#[derive(Clone, Debug)]
pub struct Cache {
    pub folder: PathBuf,
    /// The scene's, for people.
    pub name: String,
    /// See [`fingerprint`].
    pub scene: u64,
}

/// An image that is taken for the truth, and how far it may be from that.
#[derive(Clone, Debug)]
pub struct Reference {
    pub image: Image,
    /// Of each pixel's mean.
    variance: Vec<[f32; 3]>,
    /// Samples per pixel.
    pub spp: u32,
    /// Its expected mean square error.
    pub mse: f64,
    /// Its expected relMSE.
    pub rel_mse: f64,
    /// What it took; `None` where it was kept.
    pub seconds: Option<f64>,
    /// Where it is kept.
    pub file: Option<PathBuf>,
}

impl Reference {
    /// On rank 0: the reference for `settings`, but for their seed, sampler and number of samples: read, or rendered from the stage's first work. `tell` hears what takes long and
    /// what is wrong with a kept one.
    ///
    /// # Errors
    /// A render's, or the cache can't be written.
    pub fn obtain(
        stage: &mut Stage,
        settings: &ImageSettings,
        quality: Quality,
        cache: Option<&Cache>,
        tell: &dyn Fn(&str),
    ) -> Result<Reference> {
        let candidates = match quality {
            Quality::Samples(spp) => vec![whole_parts(spp)],
            // The best that there is.
            Quality::Seconds(_) => std::iter::successors(Some(MOST), |spp| Some(spp / 2))
                .take_while(|&spp| spp >= LEAST)
                .collect(),
        };
        for &spp in &candidates {
            let Some(path) = cache.map(|cache| cache.path(settings, spp)) else { continue };
            if path.exists() {
                match read_kept(&path, settings, spp) {
                    Ok(kept) => return Ok(kept),
                    Err(error) => tell(&format!("the kept reference is of no use and is made anew: {error}")),
                }
            }
        }
        let (spp, foretold) = match quality {
            Quality::Samples(spp) => (whole_parts(spp), None),
            Quality::Seconds(limit) => {
                let look = ImageSettings { spp: PARTS, seed: SEED, ..settings.clone() };
                let each = stage.shoot(0, Precision::Exact, &look)?.seconds / f64::from(PARTS);
                let most = (limit / each).clamp(LEAST.into(), MOST.into()) as u32;
                let spp = 1 << most.ilog2();
                (spp, Some(each * f64::from(spp)))
            }
        };
        let about = foretold.map_or(String::new(), |seconds| format!(", about {seconds:.0} s"));
        tell(&format!("rendering a reference of {spp} samples per pixel{about}"));
        let mut made = render(stage, settings, spp)?;
        if let Some(cache) = cache {
            let path = cache.path(settings, spp);
            made.write(settings, &path)?;
            made.file = Some(path);
        }
        Ok(made)
    }

    fn new(image: Image, variance: Vec<[f32; 3]>, spp: u32) -> Reference {
        let (mut mse, mut rel_mse) = (0.0, 0.0);
        for (&v, &r) in variance.as_flattened().iter().zip(image.pixels.as_flattened()) {
            mse += f64::from(v);
            rel_mse += f64::from(v) / (f64::from(r) * f64::from(r) + RELATIVE_EPSILON);
        }
        let count = image.pixels.len() as f64 * 3.0;
        Reference {
            image,
            variance,
            spp,
            mse: mse / count,
            rel_mse: rel_mse / count,
            seconds: None,
            file: None,
        }
    }

    fn write(&self, settings: &ImageSettings, path: &Path) -> Result<()> {
        let metadata = metadata::describe(&reference_settings(settings, self.spp));
        let options = WriteOptions { encoding: Encoding::Linear, metadata };
        let target = Target::File { path: path.into(), format: Format::Exr };
        let freedom = vec![(PARTS - 1) as f32; self.variance.len()];
        let layers = [Layer::variance(self.variance.clone()), Layer::freedom(freedom)];
        write::write_with_layers(&self.image, &layers, &target, &options)
    }
}

/// The next number of samples that the parts can share.
fn whole_parts(spp: u32) -> u32 {
    spp.next_multiple_of(PARTS)
}

/// What the parts are rendered with together.
fn reference_settings(settings: &ImageSettings, spp: u32) -> ImageSettings {
    ImageSettings {
        spp,
        seed: SEED,
        sampler: SamplerKind::Sobol,
        error_target: None,
        variance: false,
        ..settings.clone()
    }
}

fn render(stage: &mut Stage, settings: &ImageSettings, spp: u32) -> Result<Reference> {
    let pixels = settings.crop.width() as usize * settings.crop.height() as usize;
    let (mut sums, mut squares) = (vec![[0.0_f64; 3]; pixels], vec![[0.0_f64; 3]; pixels]);
    let mut seconds = 0.0;
    for part in 0..PARTS {
        let own = reference_settings(settings, spp / PARTS);
        let shot =
            stage.shoot(0, Precision::Exact, &ImageSettings { seed: SEED + u64::from(part), ..own })?;
        seconds += shot.seconds;
        for (i, pixel) in shot.rendered.image.pixels.iter().enumerate() {
            for k in 0..3 {
                let value = f64::from(pixel[k]);
                sums[i][k] += value;
                squares[i][k] += value * value;
            }
        }
    }
    let n = f64::from(PARTS);
    let mut image = Image::new(settings.crop.width(), settings.crop.height());
    let mut variance = vec![[0.0; 3]; pixels];
    for i in 0..pixels {
        for k in 0..3 {
            let mean = sums[i][k] / n;
            image.pixels[i][k] = mean as f32;
            variance[i][k] = ((squares[i][k] - n * mean * mean).max(0.0) / (n - 1.0) / n) as f32;
        }
    }
    Ok(Reference { seconds: Some(seconds), ..Reference::new(image, variance, spp) })
}

impl Cache {
    /// The file's name says all that the reference depends on, so that a stale one is never found.
    fn path(&self, settings: &ImageSettings, spp: u32) -> PathBuf {
        let mut hash = Fnv::default();
        hash.add(&self.scene.to_le_bytes());
        hash.add(&PARTS.to_le_bytes());
        for (key, value) in metadata::describe(&reference_settings(settings, spp)) {
            hash.add(format!("{key}={value}\n").as_bytes());
        }
        self.folder.join(format!("{}-{:016x}-{spp}.exr", self.name, hash.0))
    }
}

fn read_kept(path: &Path, settings: &ImageSettings, spp: u32) -> Result<Reference> {
    let refuse = |what: &str| Error::scene(path, None, what, "leave it to be replaced");
    let found = read::read_layers(path)?;
    if (found.image.width, found.image.height) != (settings.crop.width(), settings.crop.height()) {
        return Err(refuse("it is of another size"));
    }
    let variance = found.variance().ok_or_else(|| refuse("it has no layer `variance`"))?.to_vec();
    if !variance.as_flattened().iter().all(|&v| v >= 0.0 && v.is_finite()) {
        return Err(refuse("its layer `variance` holds what is no variance"));
    }
    Ok(Reference { file: Some(path.into()), ..Reference::new(found.image, variance, spp) })
}

/// A number that tells scenes apart, by all that they hold, wherever it was read from.
///
/// # Errors
/// A header too large to be sent.
pub fn fingerprint(scene: &Scene) -> Result<u64> {
    let surfaces = &scene.surfaces;
    let mut hash = Fnv::default();
    hash.add(&wire::pack(&scene.header)?);
    hash.add(cast_slice(&surfaces.positions[..]));
    hash.add(cast_slice(&surfaces.triangles[..]));
    hash.add(cast_slice(&surfaces.spheres[..]));
    hash.add(cast_slice(&surfaces.objects[..]));
    hash.add(cast_slice(&surfaces.normals[..]));
    hash.add(cast_slice(&surfaces.uvs[..]));
    hash.add(cast_slice(&surfaces.colors[..]));
    for texture in &scene.textures {
        hash.add(&texture.width.to_le_bytes());
        hash.add(&texture.height.to_le_bytes());
        hash.add(cast_slice(&texture.texels[..]));
    }
    Ok(hash.0)
}

/// FNV-1a (Fowler, Noll, Vo): names of files must stay the same, which std's hashes don't promise.
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Fnv(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    /// Adds bytes and their number, so that what ends one array can't begin the next.
    fn add(&mut self, bytes: &[u8]) {
        for &byte in (bytes.len() as u64).to_le_bytes().iter().chain(bytes) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}
