#version 300 es
// The mean of the passes, linear light, as it is shown.
precision highp float;
uniform sampler2D uLight;
out vec4 colour;

void main() {
  vec3 light = clamp(texelFetch(uLight, ivec2(gl_FragCoord.xy), 0).rgb, 0.0, 1.0);
  colour = vec4(mix(1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, light * 12.92, lessThanEqual(light, vec3(0.0031308))), 1.0);
}
