#version 300 es
// The colour of a line's speed, darker towards its rims.
precision highp float;
uniform vec3 uRamp[10];
in float across, fast;
out vec4 colour;

void main() {
  float place = clamp(fast, 0.0, 1.0) * 9.0;
  vec3 hue = mix(uRamp[int(place)], uRamp[min(int(place) + 1, 9)], fract(place)) / 255.0;
  colour = vec4(hue * (0.45 + 0.55 * sqrt(max(0.0, 1.0 - across * across))), 1.0);
}
