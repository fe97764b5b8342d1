// What the 3D page uses of three.js, and nothing else, so that a bundler leaves out the rest; README.md has the command.
export {
  BufferAttribute, BufferGeometry, Color, Frustum, InterleavedBuffer, InterleavedBufferAttribute, Line, LineBasicMaterial, Matrix4,
  PerspectiveCamera, Points, RawShaderMaterial, GLSL3, Scene, Sphere, Vector3, Vector4, WebGLRenderer,
} from "three";
