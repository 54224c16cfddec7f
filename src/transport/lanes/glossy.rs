//! Opaque surfaces that Whitted's rays meet, lit by Phong's formula.

use super::{Hits, Kind, LANES, NOTHING, NOWHERE, Numbers, Vectors, at, color_at, kept, plain_material, put};
use crate::geometry::record::{Answer, Origin, Query, RayRecord};
use crate::scene::{Color, Light};
use crate::simd::compiled;
use crate::transport::phong;
use crate::transport::whitted;
use crate::transport::{Sink, Transport, add, is_black, scaled, times};

/// Hits, and what goes on from them.
#[repr(C, align(64))]
pub struct Glossy {
    hits: Hits,
    materials: [u32; LANES],
    /// Throughput times 1 - reflectivity.
    local: Vectors,
    matt: Vectors,
    glossy: Vectors,
    shininess: [u64; LANES],
    /// Of a light: to where it is, what it gives, where shadow rays to it end, and falloff times cone.
    to_light: Vectors,
    lit: Vectors,
    t_max: Numbers,
    strength: Numbers,
    mirrored: Vectors,
}

impl Default for Glossy {
    fn default() -> Self {
        Glossy {
            hits: Hits::default(),
            materials: [0; LANES],
            local: NOWHERE,
            matt: NOWHERE,
            glossy: NOWHERE,
            shininess: [0; LANES],
            to_light: NOWHERE,
            lit: NOWHERE,
            t_max: NOTHING,
            strength: NOTHING,
            mirrored: NOWHERE,
        }
    }
}

compiled! {
    fn surfaces(glossy: &mut Glossy) = Glossy::surfaces;
}

compiled! {
    fn illuminate(glossy: &mut Glossy, light: &Light) = Glossy::illuminate;
}

impl Kind for Glossy {
    fn hits(&mut self) -> &mut Hits {
        &mut self.hits
    }

    #[inline]
    fn take(&mut self, transport: &Transport, place: usize, record: &RayRecord, answer: &Answer) -> bool {
        let Some((part, material)) = plain_material(transport, answer.primitive) else { return false };
        let exponent = phong::whole(material.shininess);
        let Some(exponent) = exponent.or(is_black(material.ks).then_some(0)) else { return false };
        if !is_black(material.kt) {
            return false;
        }
        let lane = self.hits.take(transport, part, place, record, answer);
        self.materials[lane] = part.material;
        put(&mut self.local, lane, scaled(record.throughput, 1.0 - material.reflectivity));
        put(&mut self.matt, lane, material.kd);
        put(&mut self.glossy, lane, material.ks);
        self.shininess[lane] = u64::from(exponent);
        true
    }

    fn shade(
        &mut self,
        transport: &Transport,
        records: &[RayRecord],
        _: &[Answer],
        count: usize,
        out: &mut impl Sink,
    ) {
        surfaces(self);
        let header = &transport.scene.header;
        for lane in 0..count {
            let record = &records[self.hits.places[lane] as usize];
            let material = &header.materials[self.materials[lane] as usize];
            let emission = material.emitted(self.hits.entering[lane]);
            let shown = add(times(material.ka, transport.ambient), emission);
            let glow = times(color_at(&self.local, lane), shown);
            if !is_black(glow) {
                out.deposit(record, glow);
            }
            if record.bounce < transport.max_depth {
                let weight = add(material.kr, [material.reflectivity; 3]);
                self.push_mirrored(transport, record, lane, weight, out);
            }
        }
        let world_unit = 1.0 / header.frame.scale;
        for (number, light) in header.lights.iter().enumerate() {
            for lane in 0..LANES {
                let arrival = light.arrival(at(&self.hits.position, lane), world_unit);
                put(&mut self.to_light, lane, arrival.to_light.to_array());
                (self.t_max[lane], self.strength[lane]) = (arrival.t_max, arrival.strength);
            }
            illuminate(self, light);
            for lane in 0..count {
                self.push_shadow(transport, &records[self.hits.places[lane] as usize], lane, number, out);
            }
        }
    }

    fn alone(transport: &Transport, record: &RayRecord, answer: &Answer, out: &mut impl Sink) {
        whitted::advance(transport, record, answer, out);
    }
}

impl Glossy {
    /// Where the rays end, and their mirror images.
    #[inline(always)]
    fn surfaces(&mut self) {
        self.hits.meet();
        for lane in 0..LANES {
            let (normal, geometric) = (at(&self.hits.normal, lane), at(&self.hits.geometric, lane));
            let mirrored = whitted::mirrored(at(&self.hits.direction, lane), normal, geometric);
            put(&mut self.mirrored, lane, mirrored.to_array());
        }
    }

    /// What one light gives to all hits, whose arrival is known.
    #[inline(always)]
    fn illuminate(&mut self, light: &Light) {
        for lane in 0..LANES {
            let (to_light, strength) = (at(&self.to_light, lane), self.strength[lane]);
            let matt = times(color_at(&self.matt, lane), light.diffuse);
            let glossy = times(color_at(&self.glossy, lane), light.specular);
            let to_viewer = -at(&self.hits.direction, lane);
            let [cosine, highlight] = phong::cosines(to_light, at(&self.hits.normal, lane), to_viewer);
            let power = phong::whole_power(highlight, self.shininess[lane]);
            let specular = if highlight > 0.0 { power } else { 0.0 };
            let color = add(scaled(matt, cosine * strength), scaled(glossy, specular * strength));
            let faces = to_light.dot(at(&self.hits.geometric, lane)) > 0.0;
            let goes = faces & (strength > 0.0);
            put(&mut self.lit, lane, kept(times(color_at(&self.local, lane), color), goes));
        }
    }

    fn push_shadow(
        &self,
        transport: &Transport,
        record: &RayRecord,
        lane: usize,
        light: usize,
        out: &mut impl Sink,
    ) {
        let throughput = color_at(&self.lit, lane);
        if is_black(throughput) {
            return;
        }
        let query = if transport.transparent { Query::Attenuated } else { Query::Occluded };
        let (from, direction) = (at(&self.hits.position, lane), at(&self.to_light, lane));
        let mut ray = record.onward(from, self.hits.primitives[lane], direction, query, Origin::Shadow);
        ray.throughput = throughput;
        ray.t_max = self.t_max[lane];
        ray.towards(light);
        out.push(ray);
    }

    fn push_mirrored(
        &self,
        transport: &Transport,
        record: &RayRecord,
        lane: usize,
        weight: Color,
        out: &mut impl Sink,
    ) {
        if is_black(weight) {
            return;
        }
        let (from, direction) = (at(&self.hits.position, lane), at(&self.mirrored, lane));
        let start = (from, self.hits.primitives[lane]);
        whitted::branch(transport, record, start, direction, weight, Origin::Reflection, out);
    }
}
