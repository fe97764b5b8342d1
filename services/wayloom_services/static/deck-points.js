// deck.gl draws glTF content as meshes and shows nothing of points. This makes a layer that draws the points of wayloom's 3D tiles:
//
//   import { glTFPointsLayer } from "https://…/static/deck-points.js";
//   new deck.Tile3DLayer({ data: "https://…/v1/maps/city/3dtiles/tileset.json", loader: Tiles3DLoader,
//                          _subLayerProps: { scenegraph: { type: glTFPointsLayer(deck), pointSize: 2 } } });

// Vertex colours are linear in glTF, bytes on the screen are not.
const SCREEN_BYTES = Uint8Array.from({ length: 256 }, (_, byte) => {
  const linear = byte / 255;
  return Math.round(255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055));
});

// deck: { CompositeLayer, PointCloudLayer } of deck.gl, whose copy is the page's.
export const glTFPointsLayer = ({ CompositeLayer, PointCloudLayer }) =>
  class GLTFPointsLayer extends CompositeLayer {
    static layerName = "GLTFPointsLayer";
    static defaultProps = { pointSize: 2, scenegraph: { type: "object", value: null } };

    updateState({ props, oldProps }) {
      if (props.scenegraph === oldProps.scenegraph) return;
      const { POSITION, COLOR_0 } = props.scenegraph.meshes[0].primitives[0].attributes;
      const colour = { value: Uint8Array.from(COLOR_0.value, (byte) => SCREEN_BYTES[byte]), size: 4 };
      this.setState({
        data: { length: POSITION.value.length / 3, attributes: { getPosition: { value: POSITION.value, size: 3 }, getColor: colour } },
      });
    }

    renderLayers() {
      const { coordinateSystem, coordinateOrigin, modelMatrix, pointSize } = this.props;
      return new PointCloudLayer(this.getSubLayerProps({ id: "points" }), {
        data: this.state.data, coordinateSystem, coordinateOrigin, modelMatrix, pointSize, material: { unlit: true },
      });
    }
  };
