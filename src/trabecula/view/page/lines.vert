#version 300 es
// A ribbon of two triangles for each segment of a line, across the line of sight; its depth is the way along the ray.
layout(location = 0) in vec3 start;
layout(location = 1) in vec3 end;
layout(location = 2) in float speed;
uniform vec3 uCentre, uRight, uUp, uViewer;
uniform vec2 uPan, uJitter, uSize;
uniform vec4 uScale;   // edge of a pixel, free pixels below, distance of the viewer, half the width in pixels
out float across, fast;

vec2 pixelOf(vec3 p) {
  vec3 offset = p - uCentre;
  vec2 at = vec2(uSize.x - 1.0, uSize.y - uScale.y - 1.0) / 2.0;
  return at + vec2(dot(offset, uRight) + uPan.x, -dot(offset, uUp) - uPan.y) / uScale.x - uJitter;
}

void main() {
  vec2 first = pixelOf(start), last = pixelOf(end), along = last - first;
  along = length(along) > 1e-4 ? normalize(along) : vec2(1.0, 0.0);
  bool far = gl_VertexID > 1;
  across = (gl_VertexID & 1) == 1 ? 1.0 : -1.0;
  fast = speed;
  vec2 at = (far ? last + 0.5 * along : first - 0.5 * along) + across * uScale.w * vec2(-along.y, along.x);
  float depth = (uScale.z - dot((far ? end : start) - uCentre, uViewer)) / (2.0 * uScale.z);
  gl_Position = vec4(2.0 * (at.x + 0.5) / uSize.x - 1.0, 1.0 - 2.0 * (at.y + 0.5) / uSize.y, 2.0 * depth - 1.0, 1.0);
}
