#version 300 es
// The ray marcher and the light of the page: the same model as rays.py and shading.py, where it is explained.
// Positions are in voxels (x, y, z), the corner of voxel 0 at 0; t is a length in smallest voxel edges.
// FINE, FIELD, VEILED, LINES and REFINED are defined where they are wanted: a processor that draws runs both sides of a branch.
precision highp float;
precision highp int;
precision highp sampler3D;

uniform sampler3D uField;    // how much is drawn, 0..1, with means over 2, 4, ... voxels in its levels
uniform sampler3D uSource;   // labels, grey or colour
uniform sampler3D uLabels;   // labels, where several phases are drawn
uniform sampler3D uBlocks;   // blocks of 4 voxels: how many away the nearest with a surface is
uniform sampler3D uFineField, uFineSource;  // the same of a box in finer voxels
uniform vec3 uFineLow, uFineHigh;  // that box, in voxels of the whole
uniform float uFine;         // voxels of the box along the edge of one of the whole; 0: there is no box
uniform vec3 uSides, uInverse, uStretch;  // voxels, one over them, spacing over its smallest
uniform vec3 uCorner, uRight, uDown, uDirection;  // of the rays, in voxels
uniform vec3 uKeepLow, uKeepHigh, uGoneLow, uGoneHigh;
uniform vec4 uPlane;
uniform vec3 uLamp, uViewer, uStrength, uShade, uBackground, uDye;
uniform vec3 uAround[7];     // of two opposite directions one
uniform vec3 uAlbedo[16];
uniform vec4 uFinish[16];    // roughness, specular, absorption, scattering
uniform vec3 uRamp[10];      // sRGB 0..255, from the least to the greatest value of a field
uniform int uKind;           // 0: one phase, 1: labels, 2: grey, 3: colour, 4: a field's colours
uniform int uPass;           // of the refined light
uniform int uOnly, uLevels;
uniform vec2 uWindow;        // greys that are drawn darkest and brightest
uniform bool uCloud;         // all that is drawn is translucent
uniform float uDense[16];    // absorption of a phase by a voxel's edge, where it is translucent
uniform vec2 uOrigin, uJitter;
uniform float uHeight;
#ifdef LINES
uniform sampler2D uLineColour;
uniform highp sampler2D uLineDepth;
uniform float uLineReach;    // along the ray, where that depth is 1
#endif
uniform bool uSkip, uCount, uLinear;
out vec4 colour;

const float FAR = 1e30;
// {constants}
const float CONE = 0.16;     // the quick light's towards the lamp
const float DISC = 0.14;     // half the angle under which the lamp is seen, in the refined light
const float SKY = 48.0;      // voxels as far as material keeps the sky out
float samples = 0.0;
float reached = FAR;         // where the ray meets a surface, or a line before it
vec3 beyond;                 // light of what is there: the background, or the line

#ifdef FINE
bool isFine(vec3 p) {
  return all(greaterThan(p, uFineLow)) && all(lessThan(p, uFineHigh));
}

// Edge of the voxels at a point, in voxels of the whole.
float grain(vec3 p) {
  return isFine(p) ? 1.0 / uFine : 1.0;
}

#else
float grain(vec3 p) {
  return 1.0;
}
#endif

float field(vec3 p) {
  samples += 1.0;
#ifdef FINE
  if (isFine(p)) return textureLod(uFineField, (p - uFineLow) / (uFineHigh - uFineLow), 0.0).r;
#endif
  return textureLod(uField, p * uInverse, 0.0).r;
}

// A number 0..1 of pixel, pass and use: the permutation of O'Neill's PCG (Jarzynski and Olano 2020).
float random(uint use) {
  uvec2 at = uvec2(gl_FragCoord.xy);
  uint state = (at.x * 1973u + at.y * 9277u * 26699u) ^ (uint(uPass) * 668265263u + use * 374761393u);
  state = state * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return float(((word >> 22u) ^ word) >> 8u) / 16777216.0;
}

vec3 randomDirection(uint use) {
  float height = 2.0 * random(use) - 1.0, turn = 6.2831853 * random(use + 1u), wide = sqrt(1.0 - height * height);
  return vec3(wide * cos(turn), wide * sin(turn), height);
}

bool isCut(vec3 p) {
  if (any(lessThan(p, uKeepLow)) || any(greaterThan(p, uKeepHigh))) return true;
  if (all(greaterThan(p, uGoneLow)) && all(lessThan(p, uGoneHigh))) return true;
  return dot(uPlane.xyz, p * uStretch) > uPlane.w;
}

float density(float level, vec3 p) {
  if (isCut(p)) return 0.0;
  samples += 1.0;
  vec3 inside = clamp(min(p, uSides - p) * exp2(-level) + 0.5, 0.0, 1.0);
#ifdef FINE
  // Means of the finer voxels: thin walls of the whole are thicker than theirs.
  if (isFine(p)) {
    vec3 at = (p - uFineLow) / (uFineHigh - uFineLow);
    return textureLod(uFineField, at, level + log2(uFine)).r * inside.x * inside.y * inside.z;
  }
#endif
  return textureLod(uField, p * uInverse, level).r * inside.x * inside.y * inside.z;
}

// Entry and exit of a box, and the outward normals there.
vec2 span(vec3 origin, vec3 low, vec3 high, out vec3 first, out vec3 last) {
  vec3 safe = mix(uDirection, vec3(1e-9), lessThan(abs(uDirection), vec3(1e-9)));
  vec3 a = (low - origin) / safe, b = (high - origin) / safe;
  vec3 near = min(a, b), far = max(a, b);
  float enter = max(near.x, max(near.y, near.z)), leave = min(far.x, min(far.y, far.z));
  vec3 against = -sign(safe);
  first = against * (near.x == enter ? vec3(1, 0, 0) : near.y == enter ? vec3(0, 1, 0) : vec3(0, 0, 1));
  last = against * (far.x == leave ? vec3(1, 0, 0) : far.y == leave ? vec3(0, 1, 0) : vec3(0, 0, 1));
  return vec2(enter, leave);
}

// Length to the far side of the empty blocks around a point; less than 0 where there may be a surface: to the far side of
// the block.
float blockAhead(vec3 p) {
  ivec3 block = clamp(ivec3(floor(p / BLOCK)), ivec3(0), textureSize(uBlocks, 0) - 1);
  float away = floor(texelFetch(uBlocks, block, 0).r * 255.0 + 0.5);
  vec3 safe = mix(uDirection, vec3(1e-9), lessThan(abs(uDirection), vec3(1e-9)));
  vec3 wall = (vec3(block) + mix(vec3(1.0 - max(away, 1.0)), vec3(max(away, 1.0)), greaterThan(safe, vec3(0.0)))) * BLOCK;
  vec3 steps = (wall - p) / safe;
  float size = max(0.0, min(steps.x, min(steps.y, steps.z))) + 1e-3;
  return away < 0.5 ? -size : size;
}

float firstInside(vec3 origin, float start, float stop) {
  float before = start, t = start, until = uSkip ? start : FAR;
  for (int i = 0; i < 4096 && t < stop; i++) {
    vec3 p = origin + t * uDirection;
    float ahead = t >= until ? blockAhead(p) : -1.0;
    if (t >= until) until = t + abs(ahead);
    if (ahead > 0.0) {
      before = t;
      t += ahead;
    } else if (field(p) >= 0.5) {
      float inside = t;
      for (int k = 0; k < 6; k++) {
        float middle = 0.5 * (before + inside);
        if (field(origin + middle * uDirection) >= 0.5) inside = middle; else before = middle;
      }
      return inside;
    } else {
      before = t;
      t += 0.5 * grain(p);
    }
  }
  return FAR;
}

vec3 gradient(vec3 p) {
  vec3 h = vec3(grain(p), 0, 0);
  vec3 fall = vec3(field(p - h.xyy) - field(p + h.xyy), field(p - h.yxy) - field(p + h.yxy),
                   field(p - h.yyx) - field(p + h.yyx)) / uStretch;
  float size = length(fall);
  return size > 0.0 ? fall / size : uViewer;
}

// Up to two stretches of the ray that are kept: (start, stop) each, and the normals where they begin.
int stretches(vec3 origin, out vec4 parts, out vec3 normals[2]) {
  vec3 first, last, unused;
  vec2 kept = span(origin, uKeepLow, uKeepHigh, first, unused);
  float rate = dot(uPlane.xyz, uDirection * uStretch), height = dot(uPlane.xyz, origin * uStretch) - uPlane.w;
  if (abs(rate) < 1e-9) {
    if (height > 0.0) return 0;
  } else if (rate > 0.0) {
    kept.y = min(kept.y, -height / rate);
  } else if (-height / rate > kept.x) {
    kept.x = -height / rate;
    first = uPlane.xyz;
  }
  if (kept.x >= kept.y) return 0;
  vec2 gone = span(origin, uGoneLow, uGoneHigh, unused, last);
  gone = vec2(max(gone.x, kept.x), min(gone.y, kept.y));
  normals[0] = first;
  normals[1] = last;
  parts = vec4(kept, FAR, -FAR);
  if (gone.x < gone.y) parts = vec4(kept.x, gone.x, gone.y, kept.y);
  return 2;
}

float hit(vec3 origin, out vec3 normal, out bool flatFace) {
  vec4 parts;
  vec3 normals[2];
  int count = stretches(origin, parts, normals);
  flatFace = true;
  for (int part = 0; part < count; part++) {
    vec2 ends = part == 0 ? parts.xy : parts.zw;
    if (ends.x >= ends.y - 1e-4) continue;
    normal = normals[part];
    if (field(origin + ends.x * uDirection) >= 0.5) return ends.x;
    float t = firstInside(origin, ends.x, ends.y - 1e-4);
    if (t < FAR) {
      flatFace = false;
      normal = gradient(origin + t * uDirection);
      return t;
    }
  }
  return FAR;
}

float openness(vec3 p, vec3 normal) {
  float total = 0.0, weight = 0.0;
  for (int c = 0; c < 7; c++) {
    // Of two opposite directions one is above the surface: so all pixels have the same work.
    vec3 towards = uAround[c] * sign(dot(uAround[c], normal));
    float cosine = dot(towards, normal);
    if (cosine > 0.05) {
      float through = 1.0;
      for (int level = 1; level < uLevels && through > 0.01; level++) {
        float reach = float(1 << level);
        through *= 1.0 - min(1.0, 1.5 * density(float(level), p + reach * towards / uStretch));
      }
      total += cosine * through;
      weight += cosine;
    }
  }
  return LEAST + (1.0 - LEAST) * total / weight;
}

// Light from all round along one random ray, more often from above the surface: so that its mean is the sky that is seen.
float opennessOfRay(vec3 p, vec3 normal) {
  vec3 towards = normalize(normal + 0.999 * randomDirection(4u));
  float way = 0.0, reach = 0.5;
  for (int i = 0; i < 48 && reach < SKY && way < 3.0; i++) {
    float size = max(0.7, 0.12 * reach);
    way += size * clamp(2.0 * density(max(0.0, log2(reach * 0.12)), p + reach * towards / uStretch) - 0.4, 0.0, 1.0);
    reach += size;
  }
  return LEAST + (1.0 - LEAST) * exp(-2.0 * way);
}

// Material in the way to the lamp, in voxels; `wide`: how fast the cone towards it opens.
float wayThrough(vec3 p, vec3 lamp, float wide) {
  float way = 0.0, reach = 1.0;
  vec3 size = uSides * uStretch;
  float limit = 1.8 * max(size.x, max(size.y, size.z));
  for (int i = 0; i < 96 && reach < limit && way < 12.0; i++) {
    float level = min(float(uLevels - 1), max(0.0, ceil(log2(reach * wide))));
    vec3 q = p + reach * lamp / uStretch;
    if (any(lessThan(q, vec3(0.0))) || any(greaterThan(q, uSides))) break;
    float size = max(0.8, 0.2 * reach);
    way += size * clamp((density(level, q) - 0.2) * 1.8, 0.0, 1.0);
    reach += size;
  }
  return way;
}

float mirrored(vec4 finish, float toLamp, float toViewer, float toHalf, float between) {
  float sharp = pow(max(0.02, finish.x * finish.x), 2.0);
  float peak = sharp / pow(1.0 + (sharp - 1.0) * toHalf * toHalf, 2.0);
  float base = 0.08 * finish.y;
  float fresnel = base + (1.0 - base) * pow(1.0 - between, 5.0);
  float hidden = pow(0.5 + finish.x / 2.0, 4.0);
  float seen = 1.0 / (toLamp + sqrt(hidden + toLamp * toLamp * (1.0 - hidden)));
  return peak * fresnel * seen / (toViewer + sqrt(hidden + toViewer * toViewer * (1.0 - hidden)));
}

vec3 reflected(vec3 albedo, vec4 finish, vec3 tint, vec3 normal, float way, float inner, float around) {
  vec3 halfWay = normalize(uLamp + uViewer);
  float toLamp = dot(normal, uLamp), toViewer = max(1e-3, dot(normal, uViewer));
  float between = dot(uLamp, halfWay), faces = 0.0, gloss = 0.0;
  if (toLamp > 0.0) {
    float grazing = 2.0 * finish.x * between * between - 0.5;
    faces = toLamp * (1.0 + grazing * pow(1.0 - toLamp, 5.0)) * (1.0 + grazing * pow(max(0.0, 1.0 - toViewer), 5.0));
    gloss = toLamp * mirrored(finish, toLamp, toViewer, max(0.0, dot(normal, halfWay)), between);
  }
  vec3 absorbed = finish.z * (1.0 - albedo);
  vec3 sigma = sqrt(3.0 * absorbed * (absorbed + finish.w));
  vec3 inside = finish.w > 0.0 ? finish.w / (finish.w + absorbed) : vec3(0.0);
  vec3 left = exp(-sigma * way), turned = exp(-sigma * max(0.0, inner - ENTRY));
  vec3 dyed = albedo * tint;
  vec3 light = uStrength.x * ((1.0 - inside) * faces * left + inside * turned);
  light += (uStrength.y * uShade + uStrength.z * toViewer) * around * (1.0 + 0.7 * dyed * (1.0 - around));
  return dyed * light + uStrength.x * gloss * left;
}

vec3 toLinear(vec3 value) {
  return mix(pow((value + 0.055) / 1.055, vec3(2.4)), value / 12.92, lessThanEqual(value, vec3(0.04045)));
}

vec3 toSrgb(vec3 light) {
  light = clamp(light, 0.0, 1.0);
  return mix(1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, light * 12.92, lessThanEqual(light, vec3(0.0031308)));
}

int labelAt(vec3 p) {
#ifdef FINE
  if (isFine(p)) return int(texelFetch(uFineSource, ivec3((p - uFineLow) * uFine), 0).r * 255.0 + 0.5);
#endif
  return int(texelFetch(uLabels, clamp(ivec3(floor(p)), ivec3(0), ivec3(uSides) - 1), 0).r * 255.0 + 0.5);
}

// Colour and finish of what lies at a point.
vec3 substance(vec3 p, out vec4 finish) {
  finish = uFinish[uOnly];
  if (uKind == 0) return uAlbedo[uOnly];
  ivec3 voxel = clamp(ivec3(floor(p)), ivec3(0), ivec3(uSides) - 1);
  if (uKind == 1) {
    int label = labelAt(p);
    finish = uFinish[label];
    return uAlbedo[label];
  }
#ifdef FIELD
  if (uKind == 4) {
    // In the bands of a still.
    float band = (floor(texelFetch(uSource, voxel, 0).r * 255.0 / 256.0 * BANDS) + 0.5) / BANDS * 9.0;
    return toLinear(mix(uRamp[int(band)], uRamp[min(int(band) + 1, 9)], fract(band)) / 255.0);
  }
#endif
  vec3 value = textureLod(uSource, p * uInverse, 0.0).rgb;
  if (uKind == 3) return toLinear(value);
  float bright = clamp((value.r - uWindow.x) / max(uWindow.y - uWindow.x, 1e-3), 0.0, 1.0);
  return mix(uAlbedo[0], uAlbedo[1], bright * bright);
}

#ifdef REFINED
// One pass of the refined light: the lamp a disc, the sky by a random ray, and light that has entered the material about a
// mean free path away from where it leaves.
vec3 refined(vec3 p, vec3 step, vec3 normal, vec3 albedo, vec4 finish, vec3 tint) {
  vec3 lamp = normalize(uLamp + DISC * sqrt(random(0u)) * randomDirection(1u));
  float way = wayThrough(p + step, lamp, 0.04), inner = 0.0;
  if (finish.w > 0.0) {
    float most = 1.0 - min(albedo.r, min(albedo.g, albedo.b));
    float path = min(4.0, -log(1.0 - 0.98 * random(6u)) / (finish.w + finish.z * most));
    vec3 from = p - DEPTH * step + path * grain(p) * randomDirection(7u) / uStretch;
    inner = wayThrough(from, lamp, 0.08);
  }
  return reflected(albedo, finish, tint, normal, way, inner, opennessOfRay(p + 0.5 * step, normal));
}
#endif

vec3 solid(vec3 origin) {
  vec3 normal;
  bool flatFace;
  float t = hit(origin, normal, flatFace);
  if (t >= reached) return beyond;
  reached = t;
  vec3 p = origin + t * uDirection, step = normal / uStretch * grain(origin + t * uDirection);
  vec4 finish;
  vec3 albedo = substance(p - (uKind == 2 || uKind == 3 ? 0.5 : 0.25) * step, finish);
  vec3 tint = flatFace && uKind < 2 ? uDye : vec3(1.0);
#ifdef REFINED
  return refined(p, step, normal, albedo, finish, tint);
#else
  float way = wayThrough(p + step, uLamp, CONE), inner = finish.w > 0.0 ? wayThrough(p - DEPTH * step, uLamp, CONE) : 0.0;
  return reflected(albedo, finish, tint, normal, way, inner, openness(p + step, normal));
#endif
}

// Emission and absorption along the ray, lit by the gradient; nothing is hidden from the lamp.
vec3 cloud(vec3 origin) {
  vec4 parts;
  vec3 normals[2], light = vec3(0.0);
  int count = stretches(origin, parts, normals);
  float left = 1.0;
  for (int part = 0; part < count; part++) {
    vec2 ends = part == 0 ? parts.xy : parts.zw;
    float t = ends.x;
    for (int i = 0; i < 4096 && t < min(ends.y, reached) && left > 0.01; i++) {
      vec3 p = origin + t * uDirection;
      float ahead = uSkip ? blockAhead(p) : -1.0;
      if (ahead > 0.0) {
        t += ahead;
        continue;
      }
      float there = field(p);
      if (there > 0.004) {
        vec4 finish;
        vec3 albedo = substance(p, finish);
        float faces = abs(dot(gradient(p), uLamp));
        float taken = 1.0 - exp(-uDense[uKind == 1 ? labelAt(p) : uOnly] * there * 0.75);
        light += left * taken * albedo * (0.5 * uStrength.x * (0.6 + faces) + uStrength.y * uShade + uStrength.z);
        left *= 1.0 - taken;
      }
      t += 0.75;
    }
  }
  return light + left * beyond;
}

#ifdef VEILED
// Light of the translucent phases before the surface that the ray meets, and how much of that surface's they let through.
vec4 veil(vec3 origin) {
  vec4 parts;
  vec3 normals[2], light = vec3(0.0);
  int count = stretches(origin, parts, normals);
  float left = 1.0;
  for (int part = 0; part < count; part++) {
    vec2 ends = part == 0 ? parts.xy : parts.zw;
    float t = ends.x + 0.375, stop = min(ends.y, reached);
    for (int i = 0; i < 4096 && t < stop && left > 0.01; i++) {
      vec3 p = origin + t * uDirection;
      float ahead = uSkip ? blockAhead(p) : -1.0;
      if (ahead > 0.0) {
        t += ahead;
        continue;
      }
      samples += 1.0;
      int label = labelAt(p);
      float taken = 1.0 - exp(-uDense[label] * 0.75);
      light += left * taken * uAlbedo[label] * (0.5 * uStrength.x + uStrength.y * uShade + uStrength.z);
      left *= 1.0 - taken;
      t += 0.75;
    }
  }
  return vec4(light, left);
}
#endif

void main() {
  vec2 at = gl_FragCoord.xy - uOrigin;
  vec3 origin = uCorner + (at.x - 0.5 + uJitter.x) * uRight + (uHeight - 0.5 - at.y + uJitter.y) * uDown;
  beyond = uBackground;
#ifdef LINES
  vec4 line = texelFetch(uLineColour, ivec2(gl_FragCoord.xy), 0);
  if (line.a > 0.5) {
    reached = texelFetch(uLineDepth, ivec2(gl_FragCoord.xy), 0).r * uLineReach;
    beyond = toLinear(line.rgb);
  }
#endif
  vec3 light = uCloud ? cloud(origin) : solid(origin);
#ifdef VEILED
  vec4 before = veil(origin);
  light = before.rgb + before.a * light;
#endif
  if (uCount) {
    float many = min(samples, 65535.0);
    colour = vec4(floor(many / 256.0) / 255.0, mod(many, 256.0) / 255.0, 0.0, 1.0);
    return;
  }
  colour = vec4(uLinear ? light : toSrgb(light), 1.0);
}
