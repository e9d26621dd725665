// A robot's controller as one writes it with roslib: it knows nothing of what is at the other end.
import { once } from "node:events";
import { Ros, Service, Topic } from "roslib";

const [url, genome] = process.argv.slice(2);
const ros = new Ros({ url });
await once(ros, "connection");
const call = (name, serviceType, request) =>
  new Promise((resolve, reject) => new Service({ ros, name, serviceType }).callService(request, resolve, reject));

const spawned = await call("/spawn", "gazebo_msgs/SpawnModel", {
  model_name: "rocker", model_xml: genome, initial_pose: { position: { x: 1, y: 2, z: 0 } },
});
const states = new Topic({ ros, name: "/rocker/joint_states", messageType: "sensor_msgs/JointState" });
const pose = new Topic({ ros, name: "/rocker/torso/pose", messageType: "geometry_msgs/PoseStamped" });
const motor = new Topic({ ros, name: "/rocker/shoulder/command", messageType: "std_msgs/Float64" });
motor.advertise();
const last = {};
pose.subscribe((message) => { last.pose = message.pose; });
const reached = new Promise((resolve) => {
  states.subscribe((message) => {
    last.states = message;
    if (Math.abs(message.position[0] - 0.4) < 0.05 && last.pose) resolve();
    else motor.publish({ data: 0.4 });
  });
});
await reached;
const topics = await new Promise((resolve, reject) => ros.getTopics(resolve, reject));
const raw = await new Promise((resolve, reject) => ros.getTopicsAndRawTypes(resolve, reject));
const types = await new Promise((resolve, reject) => ros.getMessageDetails("geometry_msgs/PoseStamped", resolve, reject));
const decoded = ros.decodeTypeDefs(types);
const publishers = await new Promise((resolve, reject) => pose.getPublishers(resolve, reject));
const actions = await new Promise((resolve, reject) => ros.getActionServers(resolve, reject));
console.log(JSON.stringify({ spawned, topics, raw: raw.topics, decoded, publishers, actions, ...last }));
ros.close();
