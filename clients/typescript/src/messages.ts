// Written by tools/ts_messages.py from schemas/; do not edit.

/** x, y (up), z. */
export type Vector = readonly [number, number, number];

/** x, y, z, w. */
export type Quaternion = readonly [number, number, number, number];

/** What is in every reply. */
export interface Reply {
  /** The paths of fields of the command that the server, perhaps an older one, does not know. */
  readonly ignored?: readonly string[];
}

/** How all its sensors and motors err, besides what its genome says: of each number the larger counts. */
export interface AllFlaws {
  /** How each sensor errs. */
  readonly sensors?: Flaws;
  /** How each motor errs; noise is of controls, from -1 to 1. */
  readonly motors?: Flaws;
}

/** How each sensor errs. */
export interface Flaws {
  /** Standard deviation of what is added to each reading or control, in its unit, from 0 to 1,000; 0 if left out. */
  readonly noise?: number;
  /** How many ticks ago what is read or done was, from 0 to 64; 0 if left out. */
  readonly delay?: number;
  /**
   * How likely it fails in a tick, from 0 to 1: a sensor then reads 0, and a motor goes on as it was; 0 if left
   * out.
   */
  readonly drop_out?: number;
}

/** Parameters of the joint by their names: the same as the fields of create_joint, which they override. */
export interface JointParams {
  /**
   * Velocity that the motor aims at, in rad/s (m/s for a slide), from -100,000 to 100,000. Setting it enables the
   * motor.
   */
  readonly motor_target_velocity?: number;
  /** What the motor may give in one engine step, in N m s (N s for a slide), from 0 to 1e15. */
  readonly motor_max_impulse?: number;
  /** The most that the motor may give, in N m (N for a slide), from 0 to 1e15. */
  readonly motor_max_force?: number;
  /** Whether the motor acts. */
  readonly motor_enabled?: boolean;
  /** Position that the servo aims at, in rad (m for a slide), from -1,000,000 to 1,000,000. */
  readonly target_position?: number;
  /** Stiffness of the servo or spring, in N m/rad (N/m for a slide), from 0 to 1e15. */
  readonly stiffness?: number;
  /** Damping of the joint, in N m s/rad (N s/m for a slide), from 0 to 1e15. */
  readonly damping?: number;
  /**
   * Lowest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000. Of a conetwist:
   * the largest swing.
   */
  readonly limit_lower?: number;
  /**
   * Highest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000. Of a
   * conetwist: the largest twist.
   */
  readonly limit_upper?: number;
  /** Whether the limits hold. */
  readonly limit_enabled?: boolean;
}

/** The moving part of a cube's state. */
export interface Moving {
  /** The cube. */
  readonly cube_name: string;
  /** Centre, in m. */
  readonly position: Vector;
  /** Euler angles in rad, order Y, X, Z. */
  readonly rotation: Vector;
  /** A rotation of an answer: x, y, z, w, of unit length. */
  readonly quaternion: Quaternion;
  /** Velocity of the centre of mass, in m/s. */
  readonly linear_velocity: Vector;
  /** Angular velocity in world axes, in rad/s. */
  readonly angular_velocity: Vector;
}

/** The connection is accepted. */
export interface AuthSuccess extends Reply {
  readonly type: "auth_success";
  /** Version of the protocol. */
  readonly protocol: number;
  /** Number of this connection in the world. */
  readonly client: number;
  /** The world. */
  readonly world: string;
  /** The physics engine. */
  readonly backend: string;
  /** 2 in a planar world, else 3. One of 2, 3. */
  readonly dims: 2 | 3;
  /** Length of a tick, 1 / tick_rate. */
  readonly timestep: number;
  /** Ticks in a second of the world. */
  readonly tick_rate: number;
  /**
   * What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as it can
   * (fast). One of realtime, lockstep, fast.
   */
  readonly mode: "realtime" | "lockstep" | "fast";
  /** The role of this connection. This and the next two only in a world with roles. */
  readonly role?: string;
  /** The number of the player whose connection it is. */
  readonly player?: number;
  /** What makes a later connection that of the same player, while the host runs: a secret, as the password is. */
  readonly token?: string;
}

/** The bone is there. */
export interface BoneCreated extends Reply {
  readonly type: "bone_created";
  /** The bone, which is a joint. */
  readonly bone_name: string;
}

/** What a camera on a cube sees. The pixels may differ from machine to machine, so a replay does not compare them. */
export interface CameraImage extends Reply {
  readonly type: "camera_image";
  /** The cube. */
  readonly cube_name: string;
  /** Pixels in a row. */
  readonly width: number;
  /** Rows of pixels. */
  readonly height: number;
  /** A PNG file (8 bits each of red, green and blue), in base64. */
  readonly image: string;
}

/** A cube has another colour. */
export interface ColorSet extends Reply {
  readonly type: "color_set";
  /** The cube. */
  readonly cube_name: string;
  /** Red, green, blue and opacity, each from 0 to 1. */
  readonly color: Quaternion;
}

/** The creature is there. */
export interface CreatureSpawned extends Reply {
  readonly type: "creature_spawned";
  /** Its name. */
  readonly creature: string;
  /** The names of its cubes in the world, by their ids in the genome. */
  readonly cubes: { readonly [name: string]: string };
  /** The names of its joints in the world, by their ids in the genome. */
  readonly joints: { readonly [name: string]: string };
  /** The ids of its motors, which are those of their joints, in the order of controls. */
  readonly motors: readonly string[];
  /** The ids of its voices, in the order of controls, behind the motors. Left out where it has none. */
  readonly voices?: readonly string[];
  /** The ids of its sensors, in the order of values. */
  readonly sensors: readonly string[];
  /**
   * Where its origin is instead, in m: so that no part of it is inside the ground. Left out where it is where it
   * was to be.
   */
  readonly moved_to?: Vector;
}

/** The cube is gone. */
export interface CubeDespawned extends Reply {
  readonly type: "cube_despawned";
  /** The cube. */
  readonly cube_name: string;
  /** The joints removed with it. */
  readonly joints: readonly string[];
}

/** The cube is frozen, or free. */
export interface CubeFrozen extends Reply {
  readonly type: "cube_frozen";
  /** The cube. */
  readonly cube_name: string;
  /** Whether it is immovable. */
  readonly freeze: boolean;
}

/** All about a cube. */
export interface CubeInfo extends Reply {
  readonly type: "cube_info";
  /** The cube. */
  readonly cube_name: string;
  /** Centre, in m. */
  readonly position: Vector;
  /** Euler angles in rad, order Y, X, Z. */
  readonly rotation: Vector;
  /** A rotation of an answer: x, y, z, w, of unit length. */
  readonly quaternion: Quaternion;
  /** Velocity of the centre of mass, in m/s. */
  readonly linear_velocity: Vector;
  /** Angular velocity in world axes, in rad/s. */
  readonly angular_velocity: Vector;
  /** Edges, in m. */
  readonly size: Vector;
  /** Its shape; absent where it is a box. One of box, sphere, capsule, cylinder. */
  readonly shape?: "box" | "sphere" | "capsule" | "cylinder";
  /** Mass. */
  readonly mass: number;
  /** Coefficient of sliding friction. */
  readonly friction: number;
  /** Coefficient of restitution. */
  readonly restitution: number;
  /** Red, green, blue and opacity, each from 0 to 1. */
  readonly color: Quaternion;
  /** Its collision group, if it is in one. */
  readonly group?: string;
  /** Whether it is immovable. */
  readonly frozen: boolean;
  /** The number of the player whose it is; null: nobody's. Only in a world with roles. */
  readonly player?: number | null;
  /** Whether the engine has put it to rest. */
  readonly sleeping: boolean;
  /** The joints that hold it. */
  readonly joints: readonly string[];
  /** What it touched in the last engine step, and touches still if it sleeps. */
  readonly contacts: readonly ({
    /** What it touches; null for the ground and scenery. */
    readonly cube_name: string | null;
    /**
     * The face that is touched, in the cube's own frame: the one that the normal points most away from. One of +x,
     * -x, +y, -y, +z, -z.
     */
    readonly face: "+x" | "-x" | "+y" | "-y" | "+z" | "-z";
    /** Where, in m. */
    readonly position: Vector;
    /** From the other into the cube, of unit length, in world axes. */
    readonly normal: Vector;
    /** Normal force. */
    readonly force: number;
  })[];
  /**
   * Acceleration of the centre less that of free fall, in m/s^2, along the cube's own axes, in the last engine
   * step: 0 in free fall, 9.81 upwards at rest. Only with `sensors`.
   */
  readonly accelerometer?: Vector;
  /** Angular velocity along the cube's own axes, in rad/s. Only with `sensors`. */
  readonly gyro?: Vector;
  /**
   * How far it is from the cube's centre to the first surface along each of `rays`, in m; null if there is none
   * within `max_range`. Only with `rays`.
   */
  readonly ranges?: readonly (number | null)[];
}

/** The cube that was spawned, the cubes of the world, or both. */
export interface CubeList extends Reply {
  readonly type: "cube_list";
  /** The cube that was spawned. */
  readonly spawned?: string;
  /** All cubes, in order of creation. */
  readonly cubes?: readonly string[];
  /**
   * Where the cube is instead, in m: on top of the ground, which it would have been inside of. Left out where it
   * is where it was to be.
   */
  readonly moved_to?: Vector;
}

/** The moving part of a cube's state. */
export interface CubeState extends Reply {
  readonly type: "cube_state";
  /** The cube. */
  readonly cube_name: string;
  /** Centre, in m. */
  readonly position: Vector;
  /** Euler angles in rad, order Y, X, Z. */
  readonly rotation: Vector;
  /** A rotation of an answer: x, y, z, w, of unit length. */
  readonly quaternion: Quaternion;
  /** Velocity of the centre of mass, in m/s. */
  readonly linear_velocity: Vector;
  /** Angular velocity in world axes, in rad/s. */
  readonly angular_velocity: Vector;
}

/** The cube is where it was to be, or on top of the ground there. */
export interface CubeStateSet extends Reply {
  readonly type: "cube_state_set";
  /** The cube. */
  readonly cube_name: string;
  /**
   * Where the cube is instead, in m: on top of the ground, which it, or what is joined to it, would have been
   * inside of. Left out where it is where it was to be.
   */
  readonly moved_to?: Vector;
}

/** Cubes were joined. */
export interface CubesLinked extends Reply {
  readonly type: "cubes_linked";
  /** The names of the new joints, in order of creation. */
  readonly joints: readonly string[];
}

/** The motors have their targets. */
export interface Driven extends Reply {
  readonly type: "driven";
  /** The creature. */
  readonly creature: string;
  /** Only where it is above 1, as of a creature that lacks parts or has lost or gained some. */
  readonly layout?: number;
}

/** The food is there. */
export interface Fed extends Reply {
  readonly type: "fed";
  /** Where it is, in m. */
  readonly position: Vector;
  /** How much there is now. */
  readonly food: number;
}

/** The genome of a creature. */
export interface Genome extends Reply {
  readonly type: "genome";
  /** Its name. */
  readonly creature: string;
  /** The document, as schemas/genome.json says. */
  readonly genome: { readonly [name: string]: unknown };
}

/** The cubes belong to that player. */
export interface Given extends Reply {
  readonly type: "given";
  /** The number of the player. */
  readonly player: number;
  /**
   * The cubes that are his now: the one that was named, or those of the creature, and all that joints connect to
   * them.
   */
  readonly cubes: readonly string[];
}

/** What is heard. */
export interface Heard extends Reply {
  readonly type: "heard";
  /** The channel. */
  readonly channel: string;
  /** The voices, at most 100, the nearest first, of those equally far that of the older cube. */
  readonly voices: readonly ({
    /** The cube that says it. */
    readonly cube_name: string;
    /** What is heard of it there: where the channel fades, less than was said. */
    readonly value: readonly number[];
    /** How far it is, in m. */
    readonly distance: number;
  })[];
}

/** The joint is there. */
export interface JointCreated extends Reply {
  readonly type: "joint_created";
  /** The joint. */
  readonly joint_name: string;
}

/** One joint's reading. */
export interface JointInfo extends Reply {
  readonly type: "joint_info";
  /** The joint. */
  readonly joint_name: string;
  /** What the joint leaves free. One of fixed, hinge, slide, pin, conetwist. */
  readonly joint_type: "fixed" | "hinge" | "slide" | "pin" | "conetwist";
  /** The first cube. */
  readonly cube1: string;
  /** The second cube. */
  readonly cube2: string;
  /** Where the anchor is now, in m. */
  readonly anchor: Vector;
  /** Where the axis points now, of unit length. */
  readonly axis: Vector;
  /** Motion of cube2 relative to cube1 since they were joined, in rad (m for a slide). */
  readonly position: number;
  /** Its rate, in rad/s (m/s for a slide). */
  readonly velocity: number;
  /** What the motor gives, in N m (N for a slide). */
  readonly effort: number;
  /**
   * All parameters of set_joint_param and their values. target_position is null unless the motor is a position
   * servo.
   */
  readonly params: { readonly [name: string]: number | boolean | null };
  /** What clients keep with it, where there is any. */
  readonly notes?: { readonly [name: string]: number };
}

/** The joints of the world. */
export interface JointList extends Reply {
  readonly type: "joint_list";
  /** All joints, in order of creation. */
  readonly joints: readonly ({
    /** The joint. */
    readonly joint_name: string;
    /** What the joint leaves free. One of fixed, hinge, slide, pin, conetwist. */
    readonly joint_type: "fixed" | "hinge" | "slide" | "pin" | "conetwist";
    /** The first cube. */
    readonly cube1: string;
    /** The second cube. */
    readonly cube2: string;
  })[];
}

/** The parameter is set. */
export interface JointParamSet extends Reply {
  readonly type: "joint_param_set";
  /** The joint. */
  readonly joint_name: string;
  /** The parameter. */
  readonly param_name: string;
  /** Its value. */
  readonly value: number | boolean;
}

/** Parameters of a joint were set. */
export interface JointParamsSet extends Reply {
  readonly type: "joint_params_set";
  /** The joint. */
  readonly joint_name: string;
  /** The parameters that were set, with the values of the command. */
  readonly params: { readonly [name: string]: number | boolean };
}

/** The joint is gone. */
export interface JointRemoved extends Reply {
  readonly type: "joint_removed";
  /** The joint. */
  readonly joint_name: string;
}

/** The joints of a cube. */
export interface JointsForCube extends Reply {
  readonly type: "joints_for_cube";
  /** The cube. */
  readonly cube_name: string;
  /** Their names, in order of creation. */
  readonly joints: readonly string[];
}

/** The ecosystem. */
export interface Life extends Reply {
  readonly type: "life";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
  /** How many were born of parents so far. */
  readonly born: number;
  /** How many died so far. */
  readonly died: number;
  /** What there is to eat, the oldest first. */
  readonly food: readonly ({
    /** In m. */
    readonly position: Vector;
    /** In J. */
    readonly energy: number;
  })[];
  /** Who lives, in the order in which they came. */
  readonly living: readonly ({
    /** Its name. */
    readonly creature: string;
    /** What it has, in J. */
    readonly energy: number;
    /** Since it came, in s. */
    readonly age: number;
    /** Its generation. */
    readonly generation: number;
    /** The number of its species. */
    readonly species: number;
    /** Of whom it was born. */
    readonly parents: readonly string[];
    /** How often it ate. */
    readonly meals: number;
  })[];
}

/** What makes the world tick. */
export interface ModeSet extends Reply {
  readonly type: "mode_set";
  /**
   * What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as it can
   * (fast). One of realtime, lockstep, fast.
   */
  readonly mode: "realtime" | "lockstep" | "fast";
  /** Seconds of the world in one second of the clock, in mode realtime. */
  readonly rate: number;
  /** There, and true, where the world waits for all who control it. */
  readonly barrier?: boolean;
}

/** The objective counts from now on. */
export interface ObjectiveSet extends Reply {
  readonly type: "objective_set";
  /** What it is called. */
  readonly name: string;
  /** The body that it is about. */
  readonly cubes: readonly string[];
  /** The quantities that it names. */
  readonly needs: readonly string[];
}

/** The creature has the part. */
export interface PartGrown extends Reply {
  readonly type: "part_grown";
  /** The creature. */
  readonly creature: string;
  /** The id of the part. */
  readonly part: string;
  /** The name of its cube. */
  readonly cube: string;
  /**
   * Which of its parts a creature has: 1 while it is whole and always was, and more with each cube or joint that
   * is missing at birth, or that it loses or gains.
   */
  readonly layout: number;
}

/** The part is cut off. */
export interface PartShed extends Reply {
  readonly type: "part_shed";
  /** The creature. */
  readonly creature: string;
  /**
   * Which of its parts a creature has: 1 while it is whole and always was, and more with each cube or joint that
   * is missing at birth, or that it loses or gains.
   */
  readonly layout: number;
  /** The names of the cubes that were cut off. */
  readonly cubes: readonly string[];
}

/** The world does not tick by itself. */
export interface Paused extends Reply {
  readonly type: "paused";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
}

/** What was asked will act in the next tick. */
export interface PhysicsApplied extends Reply {
  readonly type: "physics_applied";
  /** The cube. */
  readonly cube_name: string;
}

/**
 * The planets of the world, capitalised as the deployed clients expect. In the raw dialect the object has one key
 * a planet, its name, and a list of that planet alone.
 */
export interface Planets extends Reply {
  readonly type: "planets";
  /** The planets, the one at the origin, or under it, first. */
  readonly planets: readonly ({
    /** Its name. */
    readonly Name: string;
    /** Where its centre is. */
    readonly Position: {
      /** Of its centre, in m. */
      readonly x: number;
      /** Of its centre, in m. */
      readonly y: number;
      /** Of its centre, in m. */
      readonly z: number;
    };
    /** A number of its own, drawn from the world's seed; below 0 only in the layout `corner`. */
    readonly Seed: number;
    /** A kind of landscape, for clients that draw it. */
    readonly BiomeType: number;
    /** Where resources are, from the centre of a planet whose diameter is 1: 20 in the layout `corner`, else none. */
    readonly ResourceLocations: readonly ({
      /** Along x. */
      readonly x: number;
      /** Along y. */
      readonly y: number;
      /** Along z. */
      readonly z: number;
    })[];
    /** Where trees are, likewise: 10 in the layout `corner`, else none. */
    readonly TreeLocations: readonly ({
      /** Along x. */
      readonly x: number;
      /** Along y. */
      readonly y: number;
      /** Along z. */
      readonly z: number;
    })[];
  })[];
}

/** The connection is alive. */
export interface Pong extends Reply {
  readonly type: "pong";
}

/** The world ticks by itself again. */
export interface Resumed extends Reply {
  readonly type: "resumed";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
}

/** What an objective or a metric is worth now. */
export interface Reward extends Reply {
  readonly type: "reward";
  /** The value. */
  readonly value: number;
  /** The objective, where one was asked for. */
  readonly objective?: string;
  /** The metric, where one was asked for. */
  readonly metric?: string;
  /** The cube of a metric. */
  readonly cube_name?: string;
}

/** It is said, and will be heard. */
export interface Said extends Reply {
  readonly type: "said";
  /** The channel. */
  readonly channel: string;
  /** The cube that says it. */
  readonly cube_name: string;
}

/** What the sensors of a creature read. */
export interface Senses extends Reply {
  readonly type: "senses";
  /** The creature. */
  readonly creature: string;
  /** One number a sensor, in their order; units as schemas/genome.json says. */
  readonly values: readonly number[];
  /** Only where it is above 1, as of a creature that lacks parts or has lost or gained some. */
  readonly layout?: number;
}

/** The world has ticked. */
export interface Stepped extends Reply {
  readonly type: "stepped";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
}

/** What the connection is subscribed to. */
export interface Subscribed extends Reply {
  readonly type: "subscribed";
  /** The events. */
  readonly events: readonly ("tick" | "state" | "life" | "creatures")[];
  /** Every so many ticks. */
  readonly every: number;
  /** Least motion that is reported. */
  readonly position_threshold: number;
  /** Least turn that is reported. */
  readonly rotation_threshold: number;
}

/** No events from now on. */
export interface Unsubscribed extends Reply {
  readonly type: "unsubscribed";
}

/** What world this is and what it can do. */
export interface WorldInfo extends Reply {
  readonly type: "world_info";
  /** The world. */
  readonly world: string;
  /** The physics engine. */
  readonly backend: string;
  /** Versions. */
  readonly versions: {
    /** Version of NMES. */
    readonly nmes: string;
    /** Version of the protocol. */
    readonly protocol: number;
    /** Version of the physics engine. */
    readonly engine: string;
  };
  /** 2 in a planar world, else 3. One of 2, 3. */
  readonly dims: 2 | 3;
  /** Seed of the world. */
  readonly seed: number;
  /** The world's complete config. */
  readonly config: { readonly [name: string]: unknown };
  /**
   * What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as it can
   * (fast). One of realtime, lockstep, fast.
   */
  readonly mode: "realtime" | "lockstep" | "fast";
  /** Seconds of the world in one second of the clock, in mode realtime. */
  readonly rate: number;
  /** Whether it is paused. */
  readonly paused: boolean;
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
  /** How many there are. */
  readonly counts: {
    /** Cubes. */
    readonly cubes: number;
    /** Joints. */
    readonly joints: number;
    /** Connections. */
    readonly clients: number;
  };
  /** How many there may be. */
  readonly limits: {
    /** Cubes. */
    readonly cubes: number;
    /** Joints. */
    readonly joints: number;
  };
  /** The skeletons that bones were created in, in order of their oldest bones. */
  readonly skeletons?: readonly ({
    /** The skeleton's name, as create_bone gave it. */
    readonly snake_id: string | number;
    /** Names of its bones, in order of creation. */
    readonly bones: readonly string[];
  })[];
  /** The optional commands that are served, and what the engine can do (`joint.pin`, `motor`), sorted. */
  readonly capabilities: readonly string[];
  /** Why the world is faulted, or null. */
  readonly fault: unknown;
}

/** The worlds of the host, in answer to an auth with list, create or close. The connection is closed. */
export interface WorldList extends Reply {
  readonly type: "world_list";
  /**
   * The worlds that the password opens, the host's first one first, up to 1,000 of them; after create the new one
   * alone.
   */
  readonly worlds: readonly ({
    /** The world, as auth names it. */
    readonly world: string;
    /**
     * Port on which it is the world of a client that names none; where there is no such port, the port that was
     * asked.
     */
    readonly port: number;
    /** The physics engine. */
    readonly backend: string;
    /**
     * What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as it can
     * (fast). One of realtime, lockstep, fast.
     */
    readonly mode: "realtime" | "lockstep" | "fast";
    /** How many ticks it has made; null while nobody has used it, and it is not created yet. */
    readonly frame: number | null;
    /** How many connections are in it. */
    readonly clients: number;
    /** Code of the fault that stopped it, or null. */
    readonly fault: string | null;
    /** Whether it hibernates: nobody was in it, and it was saved, to go on from there when somebody enters it. */
    readonly asleep?: boolean;
    /**
     * Port of the worker process that has the world, where the host has workers: there, too, it may be entered by
     * its name, until it moves.
     */
    readonly worker_port?: number;
    /** How fast it runs while it falls behind the clock, as a part of its pace; null: it keeps up. */
    readonly ratio?: number | null;
  })[];
  /** What an auth with list says under start to be told those behind them; null: there are none. */
  readonly next?: number | null;
}

/** The world is as it was created. */
export interface WorldReset extends Reply {
  readonly type: "world_reset";
  /** 0. */
  readonly frame: 0;
  /** Its seed. */
  readonly seed: number;
}

/** Many cubes at one moment. */
export interface WorldState extends Reply {
  readonly type: "world_state";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
  /** The cubes. */
  readonly cubes: readonly ({
    /** The cube. */
    readonly cube_name: string;
    /** Centre, in m. */
    readonly position: Vector;
    /** Euler angles in rad, order Y, X, Z. */
    readonly rotation: Vector;
    /** A rotation of an answer: x, y, z, w, of unit length. */
    readonly quaternion: Quaternion;
    /** Velocity of the centre of mass, in m/s. */
    readonly linear_velocity: Vector;
    /** Angular velocity in world axes, in rad/s. */
    readonly angular_velocity: Vector;
    /** What it touched in the last engine step, and touches still if it sleeps. */
    readonly contacts?: readonly ({
      /** What it touches; null for the ground and scenery. */
      readonly cube_name: string | null;
      /**
       * The face that is touched, in the cube's own frame: the one that the normal points most away from. One of
       * +x, -x, +y, -y, +z, -z.
       */
      readonly face: "+x" | "-x" | "+y" | "-y" | "+z" | "-z";
      /** Where, in m. */
      readonly position: Vector;
      /** From the other into the cube, of unit length, in world axes. */
      readonly normal: Vector;
      /** Normal force. */
      readonly force: number;
    })[];
    /**
     * Acceleration of the centre less that of free fall, in m/s^2, along the cube's own axes, in the last engine
     * step: 0 in free fall, 9.81 upwards at rest. Only with `sensors`.
     */
    readonly accelerometer?: Vector;
    /** Angular velocity along the cube's own axes, in rad/s. Only with `sensors`. */
    readonly gyro?: Vector;
  })[];
}

/** The world goes on without connections that did not say step in time. */
export interface BarrierTimeoutEvent {
  readonly type: "barrier_timeout";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Who is no longer waited for; nobody where fewer agents came than were to. */
  readonly clients: readonly number[];
}

/** How an ecosystem is, once a second. */
export interface CensusEvent {
  readonly type: "census";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** How many creatures live. */
  readonly population: number;
  /** How many species they are of. */
  readonly species: number;
  /** How much there is to eat. */
  readonly food: number;
  /** How many were born of parents so far. */
  readonly born: number;
  /** How many died so far. */
  readonly died: number;
  /** Of the living, the mean of each trait; empty where there are none. */
  readonly means: {
    /** kg. */
    readonly mass?: number;
    /** Longest edge of the box around the body, m. */
    readonly size?: number;
    /** How many. */
    readonly cubes?: number;
    /** How many. */
    readonly motors?: number;
    /** How many. */
    readonly sensors?: number;
    /** J. */
    readonly energy?: number;
    /** s. */
    readonly age?: number;
    /** Births since somebody who was not born here. */
    readonly generation?: number;
  };
}

/** A creature lives from now on: born of parents, or come from elsewhere. */
export interface CreatureBornEvent {
  readonly type: "creature_born";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Its name. */
  readonly creature: string;
  /**
   * How it came: with the first, because there were too few, of parents, or by a client. One of founder, newcomer,
   * birth, entered.
   */
  readonly cause: "founder" | "newcomer" | "birth" | "entered";
  /** The names of its parents, if it was born. */
  readonly parents: readonly string[];
  /** The hash of its genome, 64 hexadecimal digits; get_genome has the genome. */
  readonly genome: string;
  /** 0 of those who were not born; else one more than the first parent's. */
  readonly generation: number;
  /** The number of its species. */
  readonly species: number;
}

/**
 * A creature has lost or gained parts, has come to another stage of its development, or was refused a change. Its
 * sensors and controls stay what they were: sensors of lost parts read 0, and motors there do nothing.
 */
export interface CreatureChangedEvent {
  readonly type: "creature_changed";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Its name. */
  readonly creature: string;
  /**
   * Which of its parts a creature has: 1 while it is whole and always was, and more with each cube or joint that
   * is missing at birth, or that it loses or gains.
   */
  readonly layout: number;
  /** The ids in its genome of all cubes that it has no more. */
  readonly lost_cubes: readonly string[];
  /** The ids of all joints that it has no more. */
  readonly lost_joints: readonly string[];
  /** The stage that it is in, if its genome has rules of development. */
  readonly stage?: number;
  /** What rules of its development could not do; absent where nothing was refused. Each is tried again. */
  readonly refused?: readonly ({
    /** The number of the rule, from 0. */
    readonly rule: number;
    /** The id of the cube. */
    readonly part: string;
    /** The code of the error, such as no_room. */
    readonly code: string;
  })[];
}

/** A creature lives no more. */
export interface CreatureDiedEvent {
  readonly type: "creature_died";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Its name. */
  readonly creature: string;
  /**
   * Why: it had no energy left, was too old, somebody took a part of it away, the engine could not follow its
   * motion, or the world's rules have no finite cost for it. One of starved, old, gone, diverged, unpriced.
   */
  readonly cause: "starved" | "old" | "gone" | "diverged" | "unpriced";
  /** Its generation. */
  readonly generation: number;
  /** The number of its species. */
  readonly species: number;
  /** How often it ate. */
  readonly meals: number;
  /** How old it became, in s. */
  readonly age: number;
}

/** A creature has eaten. */
export interface FoodEatenEvent {
  readonly type: "food_eaten";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** Its name. */
  readonly creature: string;
  /** Where the food was, in m. */
  readonly position: Vector;
  /** What it gave, in J. */
  readonly energy: number;
}

/**
 * The host is about to end and lets nobody in any more. It ends when all have left, or when the time is over;
 * worlds that are open then are closed.
 */
export interface HostDrainingEvent {
  readonly type: "host_draining";
  /** How long there is to leave, in s. */
  readonly seconds: number;
}

/**
 * A realtime world falls behind the wall's clock, told about once a second until it keeps up again, or stops
 * ticking by it. What it is behind it does not catch up.
 */
export interface LaggingEvent {
  readonly type: "lagging";
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** How fast it ran of late, as a part of the pace that was asked for. */
  readonly ratio: number;
  /** How much of the clock's time it has let go since it last kept up, in s. */
  readonly behind: number;
  /** Whether it keeps up again, or stopped: the last such event. */
  readonly over: boolean;
}

/** Cubes that moved past the subscriber's thresholds since they were last sent to it. */
export interface StateEvent {
  readonly type: "state";
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** The cubes that moved. */
  readonly cubes: readonly Moving[];
  /** Cubes that are gone since the last such event. */
  readonly removed: readonly string[];
}

/** The world has ticked. */
export interface TickEvent {
  readonly type: "tick";
  /** Time of the world in s: frame / tick_rate. */
  readonly t: number;
  /** Ticks since the world was created or reset. */
  readonly frame: number;
}

/** The world is closed; the connection ends. */
export interface WorldClosedEvent {
  readonly type: "world_closed";
}

/**
 * The world has stopped: its engine cannot go on, its recording cannot be written, or the server made a mistake.
 * Commands are answered with world_faulted until reset.
 */
export interface WorldFaultEvent {
  readonly type: "world_fault";
  /** What went wrong, for programs. */
  readonly code: string;
  /** Ticks since the world was created or reset. */
  readonly frame: number;
  /** What went wrong, for people. */
  readonly message: string;
}

/**
 * Makes a cube of the world a part of a creature's body that is not there, joined to it where it is now. What a
 * lost part carried, by the body's own joints, comes along.
 */
export interface Adopt {
  /** The creature. */
  readonly creature: string;
  /** The id of the cube in its genome. What it hangs on must be there. */
  readonly part: string;
  /** The cube, which is no part of a creature. */
  readonly cube_name: string;
}

/** Adds a force to what acts on a cube during the next tick. */
export interface ApplyForce {
  /** The cube; the one that this connection spawned last if left out. */
  readonly cube_name?: string;
  /** A force in world axes, in N, each number from -1e15 to 1e15. */
  readonly force: Vector;
  /**
   * Point of the world at which the force acts, in m, each number within 1,000,000 m of the origin; the centre of
   * mass if left out.
   */
  readonly at?: Vector;
}

/**
 * Adds to what acts on a cube during the next tick, and then no more. It takes at least one of force, torque,
 * impulse and angular_impulse. A frozen cube ignores it.
 */
export interface ApplyPhysics {
  /** The cube; the one that this connection spawned last if left out. */
  readonly cube_name?: string;
  /** Force throughout the tick, world axes, in N, each number from -1e15 to 1e15. */
  readonly force?: Vector;
  /** Torque throughout the tick, world axes, in N m, each number from -1e15 to 1e15. */
  readonly torque?: Vector;
  /** Impulse at the tick's start, world axes, in N s, each number from -1e15 to 1e15. */
  readonly impulse?: Vector;
  /** Angular impulse at the tick's start, world axes, in N m s, each number from -1e15 to 1e15. */
  readonly angular_impulse?: Vector;
  /**
   * Point of the world at which force and impulse act, in m, each number within 1,000,000 m of the origin; the
   * centre of mass if left out.
   */
  readonly at?: Vector;
}

/** Asks what an objective of this connection is worth now, or a metric of a cube. */
export interface ComputeReward {
  /**
   * Name of the objective; objective, as set_objective calls one that has no other name, if left out. Not together
   * with a metric.
   */
  readonly objective?: string;
  /**
   * The metric: distance (m) from the target, or from where the cube was spawned; displacement (m) from there
   * along the axis; height (m) above y = 0; speed (m/s); uprightness, the cosine of the angle between its own y
   * axis and up; energy (J), what the motors of its joints have worked so far. One of distance, displacement,
   * height, speed, uprightness, energy.
   */
  readonly metric?: "distance" | "displacement" | "height" | "speed" | "uprightness" | "energy";
  /** The cube of a metric; the one that this connection spawned last if left out. */
  readonly cube?: string;
  /** For the metric distance: where it is measured from, in m, each number from -1,000,000 to 1,000,000. */
  readonly target?: Vector;
  /**
   * For the metric displacement: the direction in which it counts; its length does not matter, but each number is
   * from -1,000 to 1,000 and one at least 0.000001 in size. Default: [1, 0, 0].
   */
  readonly axis?: Vector;
}

/** Joins two cubes by a conetwist joint that belongs to a named skeleton. */
export interface CreateBone {
  /** The first cube. */
  readonly cube1: string;
  /** The second cube. */
  readonly cube2: string;
  /**
   * The skeleton: a name, or a whole number from 0 to 9,007,199,254,740,991; "skeleton" if left out. Default:
   * skeleton.
   */
  readonly snake_id?: string | number;
  /** What to call the bone: a name that no joint has. If left out, a name is drawn. */
  readonly joint_name?: string;
  /** Whether, where a joint has that name, a number is put behind it (hip_2, hip_3) instead of refusing. */
  readonly number_if_taken?: boolean;
  /** Parameters of the joint by their names: the same as the fields of create_joint, which they override. */
  readonly joint_params?: JointParams;
  /** Numbers by name to keep with the joint. They have no effect; get_joint_info tells them. */
  readonly notes?: { readonly [name: string]: number };
}

/**
 * Joins two cubes as they stand; their relative pose becomes the joint's zero. Jointed cubes do not collide with
 * each other.
 */
export interface CreateJoint {
  /** The first cube. */
  readonly cube1: string;
  /** The second cube: a position is its motion relative to the first. */
  readonly cube2: string;
  /**
   * What the joint leaves free: nothing (fixed), a turn about the axis (hinge), a shift along it (slide; slider is
   * another word for it), every rotation (pin), or rotation within a cone (conetwist). One of fixed, hinge, slide,
   * slider, pin, conetwist.
   */
  readonly joint_type: "fixed" | "hinge" | "slide" | "slider" | "pin" | "conetwist";
  /**
   * The anchor, a point of the world in m, each number within 1,000,000 m of the origin; the midpoint of the two
   * cubes if left out.
   */
  readonly position?: Vector;
  /**
   * The axis, a direction of the world of any length, each number from -1,000 to 1,000 and one at least 0.000001
   * in size; z for a hinge and x for a slide if left out.
   */
  readonly axis?: Vector;
  /**
   * Lowest and highest position, in rad (m for a slide), each from -1,000,000 to 1,000,000: limit_lower and
   * limit_upper in one, enabled. Of a conetwist: the largest swing of its axis and the largest twist about it.
   */
  readonly limits?: readonly number[];
  /**
   * Velocity that the motor aims at, in rad/s (m/s for a slide), from -100,000 to 100,000. Setting it enables the
   * motor.
   */
  readonly motor_target_velocity?: number;
  /** What the motor may give in one engine step, in N m s (N s for a slide), from 0 to 1e15. */
  readonly motor_max_impulse?: number;
  /** The most that the motor may give, in N m (N for a slide), from 0 to 1e15. */
  readonly motor_max_force?: number;
  /** Whether the motor acts. */
  readonly motor_enabled?: boolean;
  /** Position that the servo aims at, in rad (m for a slide), from -1,000,000 to 1,000,000. */
  readonly target_position?: number;
  /** Stiffness of the servo or spring, in N m/rad (N/m for a slide), from 0 to 1e15. */
  readonly stiffness?: number;
  /** Damping of the joint, in N m s/rad (N s/m for a slide), from 0 to 1e15. */
  readonly damping?: number;
  /**
   * Lowest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000. Of a conetwist:
   * the largest swing.
   */
  readonly limit_lower?: number;
  /**
   * Highest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000. Of a
   * conetwist: the largest twist.
   */
  readonly limit_upper?: number;
  /** Whether the limits hold. */
  readonly limit_enabled?: boolean;
  /** What to call the joint: a name that no joint has. If left out, a name is drawn. */
  readonly joint_name?: string;
  /** Whether, where a joint has that name, a number is put behind it (hip_2, hip_3) instead of refusing. */
  readonly number_if_taken?: boolean;
  /** Parameters of the joint by their names: the same as the fields of create_joint, which they override. */
  readonly joint_params?: JointParams;
  /** Numbers by name to keep with the joint. They have no effect; get_joint_info tells them. */
  readonly notes?: { readonly [name: string]: number };
}

/** Removes a cube and the joints that hold it. */
export interface DespawnCube {
  /** The cube. */
  readonly cube_name: string;
}

/**
 * Sets what the motors of a creature aim at and what its voices say, until it is driven again. What
 * set_joint_param of each motor's target and say of each channel do, in one.
 */
export interface Drive {
  /** The creature. */
  readonly creature: string;
  /**
   * One number a motor, in their order, each from -1 to 1: the lower and the upper end of the motor's range; then
   * one number a voice.
   */
  readonly controls: readonly number[];
  /**
   * Only if its layout is still this one, as creature_changed or an answer told it, from 1 to 1,000,000; whichever
   * it is if left out.
   */
  readonly layout?: number;
}

/** Puts food somewhere on the ground, in a world that has life. */
export interface Feed {
  /** Where, in m, each number within 1,000,000 m of the origin; its height counts for nothing. */
  readonly position: Vector;
  /** What it feeds, in J, from 0 to 1,000,000,000; as what grows, if left out. */
  readonly energy?: number;
}

/** Makes a cube immovable, or movable again with no velocity. */
export interface FreezeCube {
  /** The cube. */
  readonly cube_name: string;
  /** Whether it is immovable from now on. */
  readonly freeze: boolean;
}

/** Takes a picture from a camera that sits on a cube. Cubes and scenery are where they were after the last tick. */
export interface GetCamera {
  /** The cube; the one that this connection spawned last if left out. */
  readonly cube_name?: string;
  /** Pixels in a row, from 1 to 1,024. Default: 320. */
  readonly width?: number;
  /** Rows of pixels, from 1 to 1,024. Default: 240. */
  readonly height?: number;
  /** Vertical field of view, in rad, from 0.01 to 3. Default: 1. */
  readonly fov?: number;
  /**
   * Where on the cube, in its own frame, in m, each number from -1,000,000 to 1,000,000. From within a cube one
   * sees out, not its faces. Default: [0, 0, 0].
   */
  readonly position?: Vector;
  /**
   * How the camera is turned in the cube's own frame: 3 Euler angles in rad, or a quaternion, each number from
   * -1,000 to 1,000 and not all of a quaternion nearer to 0 than 0.000001. Unturned it looks along the cube's -z,
   * with +y upwards. Default: [0, 0, 0].
   */
  readonly rotation?: Vector | Quaternion;
}

/** Reads all about one cube. */
export interface GetCubeInfo {
  /** The cube. */
  readonly cube_name: string;
  /** Whether to read the accelerometer and the gyro too. */
  readonly sensors?: boolean;
  /**
   * Directions in the cube's own frame in which to measure distances, from its centre. Their lengths do not
   * matter, but each of their numbers is from -1,000 to 1,000, and one at least 0.000001 in size.
   */
  readonly rays?: readonly Vector[];
  /** How far the range finder reaches, in m, from 0.001 to 1,000,000. Default: 100. */
  readonly max_range?: number;
}

/** Lists the cubes of the world, in order of creation. */
export interface GetCubeList {
}

/** Reads the moving part of one cube's state. */
export interface GetCubeState {
  /** The cube; the one that this connection spawned last if left out. */
  readonly cube_name?: string;
}

/** Reads the genome of a creature: what it was made from, or born with. */
export interface GetGenome {
  /** The creature. */
  readonly creature: string;
}

/** Reads one joint. */
export interface GetJointInfo {
  /** The joint. */
  readonly joint_name: string;
}

/** Lists the joints of the world, in order of creation. */
export interface GetJointList {
}

/** Lists the joints of a cube. */
export interface GetJointsForCube {
  /** The cube. */
  readonly cube_name: string;
}

/** Reads the ecosystem of a world that has one: what there is to eat, and who lives. */
export interface GetLife {
}

/** Lists the planets of the world; there are none unless its scene has them. */
export interface GetPlanets {
}

/** Reads what world this is and what it can do. */
export interface GetWorldInfo {
}

/** Reads the moving part of many cubes at one moment. */
export interface GetWorldState {
  /**
   * The cubes, at most 10,000 and each once, in the order in which they are wanted; all that there are, in order
   * of creation, if left out.
   */
  readonly cubes?: readonly string[];
  /** Whether to read each cube's contacts, accelerometer and gyro too. */
  readonly sensors?: boolean;
}

/** Makes a cube or a creature, with all that joints connect to it, belong to another player. */
export interface Give {
  /** The number of the player, as auth_success tells him, from 1 to 9,007,199,254,740,991. */
  readonly player: number;
  /** The cube. Either this or creature. */
  readonly cube_name?: string;
  /** The creature. Either this or cube_name. */
  readonly creature?: string;
}

/**
 * Grows a part of a creature's body that is not there: one that is later, or that it has lost. It comes to be
 * where the genome has it, seen from the part that it hangs on, and at rest there, with its joint and motor.
 */
export interface Grow {
  /** The creature. */
  readonly creature: string;
  /** The id of the cube in its genome. What it hangs on must be there, and there must be room. */
  readonly part: string;
}

/**
 * Tells which voices on a channel are heard where a cube or the root of a creature is, the nearest first. Neither
 * hears itself.
 */
export interface Hear {
  /** The channel, one of the world's (config). */
  readonly channel: string;
  /** The creature that hears, where its root is. */
  readonly creature?: string;
  /** The cube that hears; without creature and cube_name the one that this connection spawned last. */
  readonly cube_name?: string;
}

/**
 * Joins those of the cubes with some prefix that touch or nearly touch with a face. Cubes that a joint joins
 * already are left as they are. All of them are joined or none, with at most 1,000 joints between 1,000 cubes. The
 * joints are called as by link_cube_chains.
 */
export interface LinkBodyCubes {
  /** What the names of the cubes begin with. */
  readonly prefix: string;
  /** How far apart their faces may be, in m, from 0 to 1,000. Default: 0.15. */
  readonly gap?: number;
  /**
   * What the joints leave free, as at create_joint; nothing (fixed) if left out. One of fixed, hinge, slide,
   * slider, pin, conetwist. Default: fixed.
   */
  readonly joint_type?: "fixed" | "hinge" | "slide" | "slider" | "pin" | "conetwist";
  /** Parameters of the joint by their names: the same as the fields of create_joint, which they override. */
  readonly joint_params?: JointParams;
  /** Numbers by name to keep with the joint. They have no effect; get_joint_info tells them. */
  readonly notes?: { readonly [name: string]: number };
}

/**
 * Joins neighbours in chains of cubes, as they stand: all of them or none, at most 1,000. A joint is called
 * `joint_<type>_<cube1>_<cube2>`, with a number behind it where that name is taken; where it is over 120
 * characters long, its name is drawn.
 */
export interface LinkCubeChains {
  /** The chains: arrays of the names of 2 to 1,001 cubes. */
  readonly chains: readonly (readonly string[])[];
  /**
   * What the joints leave free, as at create_joint; nothing (fixed) if left out. One of fixed, hinge, slide,
   * slider, pin, conetwist. Default: fixed.
   */
  readonly joint_type?: "fixed" | "hinge" | "slide" | "slider" | "pin" | "conetwist";
  /** Parameters of the joint by their names: the same as the fields of create_joint, which they override. */
  readonly joint_params?: JointParams;
  /** Numbers by name to keep with the joint. They have no effect; get_joint_info tells them. */
  readonly notes?: { readonly [name: string]: number };
}

/** Stops the world from ticking by itself. */
export interface Pause {
}

/** Does nothing; keeps the connection open. */
export interface Ping {
}

/** Removes a joint; the cubes keep their motion. */
export interface RemoveJoint {
  /** The joint. */
  readonly joint_name: string;
}

/**
 * Brings the world back to what it was when created: no cubes, frame 0, names as from the start. Mode, rate,
 * clients and subscriptions stay.
 */
export interface Reset {
  /** A new seed, from 0 to 9,223,372,036,854,775,807; the same as before if left out. */
  readonly seed?: number;
}

/** Lets a paused world tick by itself again. */
export interface Resume {
}

/**
 * Says numbers on a channel, where a cube or the root of a creature is. Who is in range hears them from the next
 * tick on, until the cube says something else there, or is gone.
 */
export interface Say {
  /** The channel, one of the world's (config). */
  readonly channel: string;
  /** What it says: a number from -1 to 1, or as many of them as the channel has. Left out: it falls silent there. */
  readonly value?: number | readonly number[];
  /** The creature whose root says it. */
  readonly creature?: string;
  /** The cube that says it; without creature and cube_name the one that this connection spawned last. */
  readonly cube_name?: string;
}

/** Reads the sensors of a creature. */
export interface Sense {
  /** The creature. */
  readonly creature: string;
}

/** Gives a cube another colour, which has no effect on the physics. */
export interface SetColor {
  /** The cube. */
  readonly cube_name: string;
  /** Colour as red, green, blue and, if given, opacity, each from 0 to 1. It has no effect on the physics. */
  readonly color: readonly number[];
}

/**
 * Puts a cube somewhere. The cubes that are joined to it move with it, as a rigid whole; what is left out stays as
 * it is.
 */
export interface SetCubeState {
  /** The cube. */
  readonly cube_name: string;
  /** A point of the world: x, y (up), z, in m, each within 1,000,000 m of the origin. */
  readonly position?: Vector;
  /**
   * 3 Euler angles in rad, applied in the order Y, X, Z, or a quaternion [x, y, z, w], which need not be
   * normalised but not all of it may be nearer to 0 than 0.000001. Each number is from -1,000 to 1,000.
   */
  readonly rotation?: Vector | Quaternion;
  /** Velocity of the centre of mass, in m/s, each number from -100,000 to 100,000. */
  readonly linear_velocity?: Vector;
  /** Angular velocity in world axes, in rad/s, each number from -100,000 to 100,000. */
  readonly angular_velocity?: Vector;
}

/** Sets one parameter of a joint. */
export interface SetJointParam {
  /** The joint. */
  readonly joint_name: string;
  /**
   * The parameter; what each means, its unit and its bounds stand at create_joint. One of motor_target_velocity,
   * motor_max_impulse, motor_max_force, motor_enabled, target_position, stiffness, damping, limit_lower,
   * limit_upper, limit_enabled.
   */
  readonly param_name: "motor_target_velocity" | "motor_max_impulse" | "motor_max_force" | "motor_enabled" | "target_position" | "stiffness" | "damping" | "limit_lower" | "limit_upper" | "limit_enabled";
  /**
   * The value, in the parameter's unit and bounds: at most 100,000 in size for motor_target_velocity, at most
   * 1,000,000 in size for target_position and the limits, from 0 to 1e15 for the others, and true or false for
   * motor_enabled and limit_enabled.
   */
  readonly value: unknown;
}

/** Sets several parameters of a joint, all of them or none. */
export interface SetJointParams {
  /** The joint. */
  readonly joint_name: string;
  /**
   * The parameters by their names, as create_joint has them. They act in the order in which create_joint lists
   * them.
   */
  readonly params: JointParams;
  /**
   * Numbers by name to keep with the joint, beside those that it has, at most 32 in all. They have no effect;
   * get_joint_info tells them.
   */
  readonly notes?: { readonly [name: string]: number };
}

/** Sets what makes the world tick. */
export interface SetMode {
  /**
   * What makes the world tick: the clock (realtime), the command step (lockstep), or the host as fast as it can
   * (fast). One of realtime, lockstep, fast.
   */
  readonly mode: "realtime" | "lockstep" | "fast";
  /** Seconds of the world in one second of the clock, in mode realtime, from 0.001 to 1,000; as it is if left out. */
  readonly rate?: number;
  /**
   * In mode lockstep: the world ticks when every controlling connection has said step. One controls once it has
   * said step, until it leaves or a time-out passes it over. Off, unless each set_mode says it.
   */
  readonly barrier?: boolean;
  /** With barrier: how many connections must control before the first tick, from 1 to 1,000. Default: 1. */
  readonly agents?: number;
  /**
   * With barrier: how long, by the clock, a step waits for the others, in s from 0.001 to 3,600. Those that are
   * late are told of by barrier_timeout, and no longer waited for. Default: 10.
   */
  readonly timeout?: number;
}

/**
 * Sets an objective of this connection: an expression over what cubes do from now on. docs/objectives.md tells
 * what it may name. A reset of the world forgets it.
 */
export interface SetObjective {
  /** The expression, at most 2,000 characters. What is wrong with one is refused as bad_expression, with its place. */
  readonly expression: string;
  /** What it is called; an objective of that name is replaced. A connection may have 16. Default: objective. */
  readonly name?: string;
  /**
   * The body that it is about, 1 to 256 cubes; without these and a creature, the one cube that this connection
   * spawned last.
   */
  readonly cubes?: readonly string[];
  /** The creature that it is about; the expression then knows its cubes by their ids. Not together with cubes. */
  readonly creature?: string;
  /**
   * Where distance is measured from, in m, each number from -1,000,000 to 1,000,000; where the body is now if left
   * out.
   */
  readonly target?: Vector;
}

/**
 * Cuts a part off a creature, with all that hangs on its root through it alone. The joints to the rest are
 * removed, and what is cut off is no part of it any more.
 */
export interface Shed {
  /** The creature. */
  readonly creature: string;
  /** The id of the cube in its genome; any but the root. */
  readonly part: string;
  /** Whether the cubes are taken away; else they stay where they are, as cubes of the world. */
  readonly remove?: boolean;
}

/**
 * Makes the body of a genome live: its cubes and joints, all of them or none. The brain stays outside, where
 * whoever runs it senses and drives; or the world runs it.
 */
export interface SpawnCreature {
  /** The genome, as schemas/genome.json says. */
  readonly genome: { readonly [name: string]: unknown };
  /**
   * Where the origin of the genome's body comes to be, in m, each number within 1,000,000 m of the origin. A body
   * stands on its own y = 0. Default: [0, 0, 0].
   */
  readonly position?: Vector;
  /** Its name; a cube or joint of it is called NAME.id. Drawn from the seed if left out. */
  readonly name?: string;
  /**
   * What its sensors of a target are about: a point in m, each number within 1,000,000 m of the origin, or the
   * name of a cube. The cube need not be there yet; as long as it is not, they read 0, as without a target.
   */
  readonly target?: Vector | string;
  /**
   * Whether the world runs its brain itself: before each tick it senses and drives. Such a creature takes no
   * drive.
   */
  readonly autonomous?: boolean;
  /** How all its sensors and motors err, besides what its genome says: of each number the larger counts. */
  readonly flaws?: AllFlaws;
}

/** Spawns a cube. The connection owns the cube that it spawned last. */
export interface SpawnCube {
  /** Name of the cube; the world makes one up if left out. `_BASE` is appended with is_base. */
  readonly cube_name?: string;
  /** Where its centre is, in m, each within 1,000,000 m of the origin. Default: [0, 1, 0]. */
  readonly position?: Vector;
  /**
   * 3 Euler angles in rad, applied in the order Y, X, Z, or a quaternion [x, y, z, w], which need not be
   * normalised but not all of it may be nearer to 0 than 0.000001. Each number is from -1,000 to 1,000. Default:
   * [0, 0, 0].
   */
  readonly rotation?: Vector | Quaternion;
  /** The edge of a cube, or the 3 edges of a box (x, y, z), in m, from 0.001 to 1,000. Default: 1. */
  readonly size?: number | Vector;
  /**
   * What fills the box that `size` says: all of it (box), or a sphere, which has three equal edges, or a capsule
   * or a cylinder, which has two and lies along the third (along y where all three are equal; a capsule is longer
   * than it is wide). One of box, sphere, capsule, cylinder. Default: box.
   */
  readonly shape?: "box" | "sphere" | "capsule" | "cylinder";
  /** Mass in kg, from 0.000001 to 1,000,000,000. Default: 1. */
  readonly mass?: number;
  /** Coefficient of sliding friction, from 0 to 10; the world's (config) if left out. */
  readonly friction?: number;
  /** Coefficient of restitution, from 0 to 1; the world's (config) if left out. */
  readonly restitution?: number;
  /**
   * Colour as red, green, blue and, if given, opacity, each from 0 to 1. It has no effect on the physics. Default:
   * [0.8, 0.8, 0.8, 1].
   */
  readonly color?: readonly number[];
  /** Its collision group, one of the world's (config): with whom it collides. If left out it meets everything. */
  readonly group?: string;
  /** Whether it starts frozen, `_BASE` appended to its name. */
  readonly is_base?: boolean;
  /** Velocity of the centre of mass, in m/s, each number from -100,000 to 100,000. Default: [0, 0, 0]. */
  readonly linear_velocity?: Vector;
  /** Angular velocity in world axes, in rad/s, each number from -100,000 to 100,000. Default: [0, 0, 0]. */
  readonly angular_velocity?: Vector;
  /** Whether the reply lists all cubes of the world. The default is false inside a batch. Default: True. */
  readonly list?: boolean;
}

/**
 * Makes the world tick, in mode lockstep or while it is paused; the reply comes after the last tick. With the
 * barrier of set_mode it waits for the others, and what its connection sends after it waits too.
 */
export interface Step {
  /** How many ticks, from 1 to 10,000. Default: 1. */
  readonly ticks?: number;
}

/** Asks for events. A second subscribe replaces the first. */
export interface Subscribe {
  /**
   * Which events: tick; state; of a world with life what happens in its ecosystem, whenever it does; and
   * creatures, when one of them has lost or gained parts, or develops. Default: ['tick', 'state'].
   */
  readonly events?: readonly ("tick" | "state" | "life" | "creatures")[];
  /** Only every so many ticks, from 1 to 1,000,000. Default: 1. */
  readonly every?: number;
  /** How far a cube must have moved since it was last sent to be sent again, in m, from 0 to 1,000,000. */
  readonly position_threshold?: number;
  /** How far a cube must have turned since it was last sent to be sent again, in rad, from 0 to 1,000. */
  readonly rotation_threshold?: number;
}

/** Ends the events. */
export interface Unsubscribe {
}

/** A command as it is written: its type and its fields. */
export type Command =
  | ({ type: "adopt" } & Adopt)
  | ({ type: "apply_force" } & ApplyForce)
  | ({ type: "apply_physics" } & ApplyPhysics)
  | ({ type: "compute_reward" } & ComputeReward)
  | ({ type: "create_bone" } & CreateBone)
  | ({ type: "create_joint" } & CreateJoint)
  | ({ type: "despawn_cube" } & DespawnCube)
  | ({ type: "drive" } & Drive)
  | ({ type: "feed" } & Feed)
  | ({ type: "freeze_cube" } & FreezeCube)
  | ({ type: "get_camera" } & GetCamera)
  | ({ type: "get_cube_info" } & GetCubeInfo)
  | ({ type: "get_cube_list" } & GetCubeList)
  | ({ type: "get_cube_state" } & GetCubeState)
  | ({ type: "get_genome" } & GetGenome)
  | ({ type: "get_joint_info" } & GetJointInfo)
  | ({ type: "get_joint_list" } & GetJointList)
  | ({ type: "get_joints_for_cube" } & GetJointsForCube)
  | ({ type: "get_life" } & GetLife)
  | ({ type: "get_planets" } & GetPlanets)
  | ({ type: "get_world_info" } & GetWorldInfo)
  | ({ type: "get_world_state" } & GetWorldState)
  | ({ type: "give" } & Give)
  | ({ type: "grow" } & Grow)
  | ({ type: "hear" } & Hear)
  | ({ type: "link_body_cubes" } & LinkBodyCubes)
  | ({ type: "link_cube_chains" } & LinkCubeChains)
  | ({ type: "pause" } & Pause)
  | ({ type: "ping" } & Ping)
  | ({ type: "remove_joint" } & RemoveJoint)
  | ({ type: "reset" } & Reset)
  | ({ type: "resume" } & Resume)
  | ({ type: "say" } & Say)
  | ({ type: "sense" } & Sense)
  | ({ type: "set_color" } & SetColor)
  | ({ type: "set_cube_state" } & SetCubeState)
  | ({ type: "set_joint_param" } & SetJointParam)
  | ({ type: "set_joint_params" } & SetJointParams)
  | ({ type: "set_mode" } & SetMode)
  | ({ type: "set_objective" } & SetObjective)
  | ({ type: "shed" } & Shed)
  | ({ type: "spawn_creature" } & SpawnCreature)
  | ({ type: "spawn_cube" } & SpawnCube)
  | ({ type: "step" } & Step)
  | ({ type: "subscribe" } & Subscribe)
  | ({ type: "unsubscribe" } & Unsubscribe);

/** What the server tells those who subscribed. */
export type KnownEvent =
  | BarrierTimeoutEvent
  | CensusEvent
  | CreatureBornEvent
  | CreatureChangedEvent
  | CreatureDiedEvent
  | FoodEatenEvent
  | HostDrainingEvent
  | LaggingEvent
  | StateEvent
  | TickEvent
  | WorldClosedEvent
  | WorldFaultEvent;

/** The types of those. */
export const EVENT_TYPES: ReadonlySet<string> = new Set([
  "barrier_timeout",
  "census",
  "creature_born",
  "creature_changed",
  "creature_died",
  "food_eaten",
  "host_draining",
  "lagging",
  "state",
  "tick",
  "world_closed",
  "world_fault",
]);

/** The reply to each command. */
export interface Replies {
  adopt: PartGrown;
  apply_force: PhysicsApplied;
  apply_physics: PhysicsApplied;
  compute_reward: Reward;
  create_bone: BoneCreated;
  create_joint: JointCreated;
  despawn_cube: CubeDespawned;
  drive: Driven;
  feed: Fed;
  freeze_cube: CubeFrozen;
  get_camera: CameraImage;
  get_cube_info: CubeInfo;
  get_cube_list: CubeList;
  get_cube_state: CubeState;
  get_genome: Genome;
  get_joint_info: JointInfo;
  get_joint_list: JointList;
  get_joints_for_cube: JointsForCube;
  get_life: Life;
  get_planets: Planets;
  get_world_info: WorldInfo;
  get_world_state: WorldState;
  give: Given;
  grow: PartGrown;
  hear: Heard;
  link_body_cubes: CubesLinked;
  link_cube_chains: CubesLinked;
  pause: Paused;
  ping: Pong;
  remove_joint: JointRemoved;
  reset: WorldReset;
  resume: Resumed;
  say: Said;
  sense: Senses;
  set_color: ColorSet;
  set_cube_state: CubeStateSet;
  set_joint_param: JointParamSet;
  set_joint_params: JointParamsSet;
  set_mode: ModeSet;
  set_objective: ObjectiveSet;
  shed: PartShed;
  spawn_creature: CreatureSpawned;
  spawn_cube: CubeList;
  step: Stepped;
  subscribe: Subscribed;
  unsubscribe: Unsubscribed;
}

/** Every command of the protocol as a method. What may be left out is left to the server's default. */
export abstract class Commands {
  /** Sends a command, and waits for its reply. */
  abstract request<C extends Command>(command: C): Promise<Replies[C["type"]]>;

  /**
   * Makes a cube of the world a part of a creature's body that is not there, joined to it where it is now. What a
   * lost part carried, by the body's own joints, comes along.
   */
  adopt(command: Adopt): Promise<PartGrown> {
    return this.request({ type: "adopt", ...command });
  }

  /** Adds a force to what acts on a cube during the next tick. */
  applyForce(command: ApplyForce): Promise<PhysicsApplied> {
    return this.request({ type: "apply_force", ...command });
  }

  /**
   * Adds to what acts on a cube during the next tick, and then no more. It takes at least one of force, torque,
   * impulse and angular_impulse. A frozen cube ignores it.
   */
  applyPhysics(command: ApplyPhysics = {}): Promise<PhysicsApplied> {
    return this.request({ type: "apply_physics", ...command });
  }

  /** Asks what an objective of this connection is worth now, or a metric of a cube. */
  computeReward(command: ComputeReward = {}): Promise<Reward> {
    return this.request({ type: "compute_reward", ...command });
  }

  /** Joins two cubes by a conetwist joint that belongs to a named skeleton. */
  createBone(command: CreateBone): Promise<BoneCreated> {
    return this.request({ type: "create_bone", ...command });
  }

  /**
   * Joins two cubes as they stand; their relative pose becomes the joint's zero. Jointed cubes do not collide with
   * each other.
   */
  createJoint(command: CreateJoint): Promise<JointCreated> {
    return this.request({ type: "create_joint", ...command });
  }

  /** Removes a cube and the joints that hold it. */
  despawnCube(command: DespawnCube): Promise<CubeDespawned> {
    return this.request({ type: "despawn_cube", ...command });
  }

  /**
   * Sets what the motors of a creature aim at and what its voices say, until it is driven again. What
   * set_joint_param of each motor's target and say of each channel do, in one.
   */
  drive(command: Drive): Promise<Driven> {
    return this.request({ type: "drive", ...command });
  }

  /** Puts food somewhere on the ground, in a world that has life. */
  feed(command: Feed): Promise<Fed> {
    return this.request({ type: "feed", ...command });
  }

  /** Makes a cube immovable, or movable again with no velocity. */
  freezeCube(command: FreezeCube): Promise<CubeFrozen> {
    return this.request({ type: "freeze_cube", ...command });
  }

  /** Takes a picture from a camera that sits on a cube. Cubes and scenery are where they were after the last tick. */
  getCamera(command: GetCamera = {}): Promise<CameraImage> {
    return this.request({ type: "get_camera", ...command });
  }

  /** Reads all about one cube. */
  getCubeInfo(command: GetCubeInfo): Promise<CubeInfo> {
    return this.request({ type: "get_cube_info", ...command });
  }

  /** Lists the cubes of the world, in order of creation. */
  getCubeList(): Promise<CubeList> {
    return this.request({ type: "get_cube_list" });
  }

  /** Reads the moving part of one cube's state. */
  getCubeState(command: GetCubeState = {}): Promise<CubeState> {
    return this.request({ type: "get_cube_state", ...command });
  }

  /** Reads the genome of a creature: what it was made from, or born with. */
  getGenome(command: GetGenome): Promise<Genome> {
    return this.request({ type: "get_genome", ...command });
  }

  /** Reads one joint. */
  getJointInfo(command: GetJointInfo): Promise<JointInfo> {
    return this.request({ type: "get_joint_info", ...command });
  }

  /** Lists the joints of the world, in order of creation. */
  getJointList(): Promise<JointList> {
    return this.request({ type: "get_joint_list" });
  }

  /** Lists the joints of a cube. */
  getJointsForCube(command: GetJointsForCube): Promise<JointsForCube> {
    return this.request({ type: "get_joints_for_cube", ...command });
  }

  /** Reads the ecosystem of a world that has one: what there is to eat, and who lives. */
  getLife(): Promise<Life> {
    return this.request({ type: "get_life" });
  }

  /** Lists the planets of the world; there are none unless its scene has them. */
  getPlanets(): Promise<Planets> {
    return this.request({ type: "get_planets" });
  }

  /** Reads what world this is and what it can do. */
  getWorldInfo(): Promise<WorldInfo> {
    return this.request({ type: "get_world_info" });
  }

  /** Reads the moving part of many cubes at one moment. */
  getWorldState(command: GetWorldState = {}): Promise<WorldState> {
    return this.request({ type: "get_world_state", ...command });
  }

  /** Makes a cube or a creature, with all that joints connect to it, belong to another player. */
  give(command: Give): Promise<Given> {
    return this.request({ type: "give", ...command });
  }

  /**
   * Grows a part of a creature's body that is not there: one that is later, or that it has lost. It comes to be
   * where the genome has it, seen from the part that it hangs on, and at rest there, with its joint and motor.
   */
  grow(command: Grow): Promise<PartGrown> {
    return this.request({ type: "grow", ...command });
  }

  /**
   * Tells which voices on a channel are heard where a cube or the root of a creature is, the nearest first.
   * Neither hears itself.
   */
  hear(command: Hear): Promise<Heard> {
    return this.request({ type: "hear", ...command });
  }

  /**
   * Joins those of the cubes with some prefix that touch or nearly touch with a face. Cubes that a joint joins
   * already are left as they are. All of them are joined or none, with at most 1,000 joints between 1,000 cubes.
   * The joints are called as by link_cube_chains.
   */
  linkBodyCubes(command: LinkBodyCubes): Promise<CubesLinked> {
    return this.request({ type: "link_body_cubes", ...command });
  }

  /**
   * Joins neighbours in chains of cubes, as they stand: all of them or none, at most 1,000. A joint is called
   * `joint_<type>_<cube1>_<cube2>`, with a number behind it where that name is taken; where it is over 120
   * characters long, its name is drawn.
   */
  linkCubeChains(command: LinkCubeChains): Promise<CubesLinked> {
    return this.request({ type: "link_cube_chains", ...command });
  }

  /** Stops the world from ticking by itself. */
  pause(): Promise<Paused> {
    return this.request({ type: "pause" });
  }

  /** Does nothing; keeps the connection open. */
  ping(): Promise<Pong> {
    return this.request({ type: "ping" });
  }

  /** Removes a joint; the cubes keep their motion. */
  removeJoint(command: RemoveJoint): Promise<JointRemoved> {
    return this.request({ type: "remove_joint", ...command });
  }

  /**
   * Brings the world back to what it was when created: no cubes, frame 0, names as from the start. Mode, rate,
   * clients and subscriptions stay.
   */
  reset(command: Reset = {}): Promise<WorldReset> {
    return this.request({ type: "reset", ...command });
  }

  /** Lets a paused world tick by itself again. */
  resume(): Promise<Resumed> {
    return this.request({ type: "resume" });
  }

  /**
   * Says numbers on a channel, where a cube or the root of a creature is. Who is in range hears them from the next
   * tick on, until the cube says something else there, or is gone.
   */
  say(command: Say): Promise<Said> {
    return this.request({ type: "say", ...command });
  }

  /** Reads the sensors of a creature. */
  sense(command: Sense): Promise<Senses> {
    return this.request({ type: "sense", ...command });
  }

  /** Gives a cube another colour, which has no effect on the physics. */
  setColor(command: SetColor): Promise<ColorSet> {
    return this.request({ type: "set_color", ...command });
  }

  /**
   * Puts a cube somewhere. The cubes that are joined to it move with it, as a rigid whole; what is left out stays
   * as it is.
   */
  setCubeState(command: SetCubeState): Promise<CubeStateSet> {
    return this.request({ type: "set_cube_state", ...command });
  }

  /** Sets one parameter of a joint. */
  setJointParam(command: SetJointParam): Promise<JointParamSet> {
    return this.request({ type: "set_joint_param", ...command });
  }

  /** Sets several parameters of a joint, all of them or none. */
  setJointParams(command: SetJointParams): Promise<JointParamsSet> {
    return this.request({ type: "set_joint_params", ...command });
  }

  /** Sets what makes the world tick. */
  setMode(command: SetMode): Promise<ModeSet> {
    return this.request({ type: "set_mode", ...command });
  }

  /**
   * Sets an objective of this connection: an expression over what cubes do from now on. docs/objectives.md tells
   * what it may name. A reset of the world forgets it.
   */
  setObjective(command: SetObjective): Promise<ObjectiveSet> {
    return this.request({ type: "set_objective", ...command });
  }

  /**
   * Cuts a part off a creature, with all that hangs on its root through it alone. The joints to the rest are
   * removed, and what is cut off is no part of it any more.
   */
  shed(command: Shed): Promise<PartShed> {
    return this.request({ type: "shed", ...command });
  }

  /**
   * Makes the body of a genome live: its cubes and joints, all of them or none. The brain stays outside, where
   * whoever runs it senses and drives; or the world runs it.
   */
  spawnCreature(command: SpawnCreature): Promise<CreatureSpawned> {
    return this.request({ type: "spawn_creature", ...command });
  }

  /** Spawns a cube. The connection owns the cube that it spawned last. */
  spawnCube(command: SpawnCube = {}): Promise<CubeList> {
    return this.request({ type: "spawn_cube", ...command });
  }

  /**
   * Makes the world tick, in mode lockstep or while it is paused; the reply comes after the last tick. With the
   * barrier of set_mode it waits for the others, and what its connection sends after it waits too.
   */
  step(command: Step = {}): Promise<Stepped> {
    return this.request({ type: "step", ...command });
  }

  /** Asks for events. A second subscribe replaces the first. */
  subscribe(command: Subscribe = {}): Promise<Subscribed> {
    return this.request({ type: "subscribe", ...command });
  }

  /** Ends the events. */
  unsubscribe(): Promise<Unsubscribed> {
    return this.request({ type: "unsubscribe" });
  }
}
