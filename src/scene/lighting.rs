//! Which light a path asks next: each with a chance that grows with what it sends into the scene.
//!
//! Lights are numbered: emitters, then lights without extent, then the environment.

use super::environment::{EnvironmentTable, pick};
use super::{Emitter, Environment, Light, Scene, mean};

/// What paths look up: chances of all lights, and which materials are matt. Made once of a scene's header.
#[derive(Clone, Debug, Default)]
pub struct Lighting {
    /// Sums of the chances.
    sums: Vec<f64>,
    /// Primitives of this scene, or part of one, that are emitters: id here, number of the emitter. Ascending.
    lit: Vec<(u32, u32)>,
    environment: Option<EnvironmentTable>,
    /// By material.
    matt: Vec<bool>,
}

/// A light that may be chosen.
#[derive(Clone, Copy, Debug)]
pub enum Choice<'a> {
    Emitter(&'a Emitter),
    /// Without extent.
    Light(&'a Light),
    Environment(&'a Environment, &'a EnvironmentTable),
}

/// A chosen light.
#[derive(Clone, Copy, Debug)]
pub struct Chosen<'a> {
    pub light: Choice<'a>,
    pub number: usize,
    pub chance: f64,
    /// What is left of the number that chose it, in [0, 1).
    pub rest: f64,
}

impl Scene {
    /// Makes [`Scene::lighting`]: before paths are traced, on every rank, after `header` is complete. `ids` are those in the whole scene of the primitives of a part.
    pub fn prepare_lighting(&mut self, ids: Option<&[u32]>) {
        let header = &self.header;
        let lit = header.emitters.iter().zip(0..).filter_map(|(emitter, number)| {
            let own = match ids {
                None => Some(emitter.primitive),
                Some(ids) => ids.binary_search(&emitter.primitive).ok().map(|place| place as u32),
            };
            own.map(|id| (id, number))
        });
        let environment = header.environment.as_ref().map(EnvironmentTable::new);
        let radius = header.radius.max(f64::MIN_POSITIVE);
        // What each would send to a surface as far from it as the scene is wide.
        let from_emitter = |emitter: &Emitter| mean(emitter.radiance) * emitter.area() / (radius * radius);
        let from_light = |light: &Light| {
            let strength = light.falloff.map_or(1.0, |[c, l, q]| {
                let distance = radius / header.frame.scale;
                1.0 / (c + l * distance + q * distance * distance)
            });
            std::f64::consts::PI * mean(light.diffuse) * strength
        };
        let emitters = header.emitters.iter().map(from_emitter);
        let lights = header.lights.iter().map(from_light);
        let sky = environment.as_ref().map(|table| std::f64::consts::PI * table.mean);
        let mut sums: Vec<f64> = emitters.chain(lights).chain(sky).collect();
        let mut sum = 0.0;
        for chance in &mut sums {
            sum += if chance.is_finite() { *chance } else { 0.0 };
            *chance = sum;
        }
        if sum > 0.0 && sum.is_finite() {
            sums.iter_mut().for_each(|chance| *chance /= sum);
        } else {
            sums.clear();
        }
        let matt = header.materials.iter().map(|material| material.is_matt()).collect();
        self.lighting = Lighting { sums, lit: lit.collect(), environment, matt };
    }

    /// [`Material::is_matt`](super::Material::is_matt) of a material of this scene.
    #[inline]
    pub fn is_matt(&self, material: u32) -> bool {
        self.lighting.matt.get(material as usize).is_some_and(|&matt| matt)
    }

    /// Chooses a light by a number in [0, 1). `None` if nothing shines.
    #[inline]
    pub fn choose_light(&self, u: f64) -> Option<Chosen<'_>> {
        let (number, rest) = pick(&self.lighting.sums, u)?;
        let header = &self.header;
        let (emitters, lights) = (header.emitters.len(), header.lights.len());
        let light = if number < emitters {
            Choice::Emitter(&header.emitters[number])
        } else if number < emitters + lights {
            Choice::Light(&header.lights[number - emitters])
        } else {
            let (environment, table) = self.environment()?;
            Choice::Environment(environment, table)
        };
        Some(Chosen { light, number, chance: self.chance(number), rest })
    }

    /// The emitter that a primitive of this scene, or part of one, is, and its chance to be chosen.
    pub fn emitter(&self, primitive: u32) -> Option<(&Emitter, f64)> {
        let lit = &self.lighting.lit;
        let place = lit.binary_search_by_key(&primitive, |&(id, _)| id).ok()?;
        let number = lit[place].1 as usize;
        Some((&self.header.emitters[number], self.chance(number)))
    }

    /// The image of what is infinitely far, if there is one.
    pub fn environment(&self) -> Option<(&Environment, &EnvironmentTable)> {
        Some((self.header.environment.as_ref()?, self.lighting.environment.as_ref()?))
    }

    /// The environment's chance to be chosen.
    pub fn environment_chance(&self) -> f64 {
        self.chance(self.lighting.sums.len().wrapping_sub(1))
    }

    fn chance(&self, number: usize) -> f64 {
        let sums = &self.lighting.sums;
        let Some(&sum) = sums.get(number) else { return 0.0 };
        sum - if number == 0 { 0.0 } else { sums[number - 1] }
    }
}
