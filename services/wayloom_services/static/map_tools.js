// Tools beside the map: mounted once the map is there, in whatever form it came.

// city: the map's interface; about: { info, ask, at }.
export async function mountTools(_city, _about) {}
