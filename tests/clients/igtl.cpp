// Exchanges messages by the OpenIGTLink library itself, version 1.11 or, with -DIGTL_3, 3:
//   igtl receive HOST PORT SECONDS    prints each message that can be unpacked as a line of JSON, and those that cannot
//   igtl send PORT COUNT              serves one client COUNT rounds of every type of message, 50 ms apart
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <igtlClientSocket.h>
#include <igtlImageMessage.h>
#include <igtlMath.h>
#include <igtlMessageHeader.h>
#include <igtlOSUtil.h>
#include <igtlPointMessage.h>
#include <igtlPolyDataMessage.h>
#include <igtlPositionMessage.h>
#include <igtlServerSocket.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTrackingDataMessage.h>
#include <igtlTransformMessage.h>
#include <string>

static int receive_bytes(igtl::Socket* socket, void* bytes, int n) {
#ifdef IGTL_3
    bool late = false;
    return (int)socket->Receive(bytes, n, late);
#else
    return socket->Receive(bytes, n);
#endif
}

static void skip(igtl::Socket* socket, int n) {
    std::string rest(n, 0);
    if (n > 0) receive_bytes(socket, &rest[0], n);
}

template <class T>
static typename T::Pointer body(igtl::Socket* socket, igtl::MessageHeader::Pointer header, bool& ok) {
    typename T::Pointer message = T::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    int got = receive_bytes(socket, message->GetPackBodyPointer(), message->GetPackBodySize());
    ok = got == (int)message->GetPackBodySize() && (message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY);
    return message;
}

static std::string text(const char* raw) {
    std::string out;
    for (; *raw; raw++) out += *raw == '"' || *raw == '\\' ? '\'' : *raw;
    return out;
}

static int receive(const char* host, int port, double seconds) {
    igtl::ClientSocket::Pointer socket;
    int is_open = -1;
    for (int i = 0; i < 400 && is_open != 0; i++) {
        socket = igtl::ClientSocket::New();
        is_open = socket->ConnectToServer(host, port);
        if (is_open != 0) igtl::Sleep(50);
    }
    if (is_open != 0) return 3;
    socket->SetReceiveTimeout((int)(seconds * 1000));
    for (;;) {
        igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
#ifdef IGTL_3
        header->InitBuffer();
        int n = receive_bytes(socket, header->GetBufferPointer(), header->GetBufferSize());
        if (n != (int)header->GetBufferSize()) break;
#else
        header->InitPack();
        int n = receive_bytes(socket, header->GetPackPointer(), header->GetPackSize());
        if (n != (int)header->GetPackSize()) break;
#endif
        int unpacked = header->Unpack();
        std::string type = header->GetDeviceType(), device = header->GetDeviceName();
        igtl::TimeStamp::Pointer stamp = igtl::TimeStamp::New();
        header->GetTimeStamp(stamp);
        std::string head = "{\"type\": \"" + text(type.c_str()) + "\", \"device\": \"" + text(device.c_str()) + "\", ";
        if (!(unpacked & igtl::MessageHeader::UNPACK_HEADER)) {
            std::printf("%s\"lost\": true}\n", head.c_str());
            break;
        }
        bool ok = false;
        std::string numbers;
        char number[64];
        auto add = [&](double value) {
            std::snprintf(number, sizeof number, "%s%.9g", numbers.empty() ? "" : ", ", value);
            numbers += number;
        };
        if (type == "TRANSFORM") {
            auto message = body<igtl::TransformMessage>(socket, header, ok);
            igtl::Matrix4x4 matrix;
            message->GetMatrix(matrix);
            for (auto& row : matrix)
                for (float value : row) add(value);
        } else if (type == "POINT") {
            auto message = body<igtl::PointMessage>(socket, header, ok);
            for (int i = 0; ok && i < message->GetNumberOfPointElement(); i++) {
                igtl::PointElement::Pointer point;
                message->GetPointElement(i, point);
                float p[3];
                point->GetPosition(p);
                for (float value : p) add(value);
            }
        } else if (type == "POLYDATA") {
            auto message = body<igtl::PolyDataMessage>(socket, header, ok);
            igtl::PolyDataPointArray::Pointer points;
            if (ok) points = message->GetPoints();
            for (int i = 0; points.IsNotNull() && i < points->GetNumberOfPoints(); i++) {
                igtlFloat32 p[3];
                points->GetPoint(i, p);
                for (float value : p) add(value);
            }
        } else if (type == "IMAGE") {
            auto message = body<igtl::ImageMessage>(socket, header, ok);
            int n = ok && message->GetScalarType() == igtl::ImageMessage::TYPE_FLOAT32 ? message->GetSubVolumeImageSize() / 4 : 0;
            const float* values = (const float*)message->GetScalarPointer();
            for (int i = 0; i < n; i++) add(values[i]);
            ok = ok && n > 0 && message->GetNumComponents() == 3;
        } else if (type == "STATUS") {
            auto message = body<igtl::StatusMessage>(socket, header, ok);
            add(message->GetCode());
            head += "\"name\": \"" + text(message->GetErrorName()) + "\", \"text\": \"" + text(message->GetStatusString()) + "\", ";
        } else if (type == "STRING") {
            auto message = body<igtl::StringMessage>(socket, header, ok);
            head += "\"text\": \"" + text(message->GetString()) + "\", ";
        } else {
            skip(socket, (int)header->GetBodySizeToRead());
        }
        std::printf("%s\"stamp\": %.9f, \"ok\": %s, \"numbers\": [%s]}\n", head.c_str(), stamp->GetTimeStamp(),
                    ok ? "true" : "false", numbers.c_str());
        std::fflush(stdout);
    }
    socket->CloseSocket();
    return 0;
}

template <class T>
static void put(igtl::Socket* socket, T message, const char* device, unsigned int round) {
    igtl::TimeStamp::Pointer stamp = igtl::TimeStamp::New();
    stamp->SetTime(1750000000u + round / 20, (round % 20) * 50000000u);
    message->SetDeviceName(device);
    message->SetTimeStamp(stamp);
    message->Pack();
    socket->Send(message->GetPackPointer(), message->GetPackSize());
}

static int send(int port, unsigned int count) {
    igtl::ServerSocket::Pointer server = igtl::ServerSocket::New();
    if (server->CreateServer(port) != 0) return 3;
    std::printf("ready\n");
    std::fflush(stdout);
    igtl::ClientSocket::Pointer socket = server->WaitForConnection(20000);
    if (socket.IsNull()) return 4;
    for (unsigned int round = 0; round < count; round++) {
        float turn = 0.01f * round, at[3] = {10.0f + round, -20.5f, 30.25f};
        igtl::Matrix4x4 matrix;
        igtl::IdentityMatrix(matrix);
        matrix[0][0] = matrix[1][1] = std::cos(turn);
        matrix[0][1] = -std::sin(turn);
        matrix[1][0] = std::sin(turn);
        for (int k = 0; k < 3; k++) matrix[k][3] = at[k];
        igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
        transform->SetMatrix(matrix);
        put(socket, transform, "StylusToWorld", round);

        igtl::PositionMessage::Pointer position = igtl::PositionMessage::New();
        position->SetPosition(at[0], at[1], at[2]);
        position->SetQuaternion(0.0f, 0.0f, std::sin(turn / 2), std::cos(turn / 2));
        put(socket, position, "PointerToWorld", round);

        igtl::TrackingDataMessage::Pointer tools = igtl::TrackingDataMessage::New();
        igtl::TrackingDataElement::Pointer tool = igtl::TrackingDataElement::New();
        tool->SetName("ToolToWorld");
        tool->SetType(igtl::TrackingDataElement::TYPE_6D);
        tool->SetMatrix(matrix);
        tools->AddTrackingDataElement(tool);
        put(socket, tools, "Tracker", round);

        igtl::PointMessage::Pointer points = igtl::PointMessage::New();
        for (int k = 0; k < 3; k++) {
            igtl::PointElement::Pointer point = igtl::PointElement::New();
            char name[8];
            std::snprintf(name, sizeof name, "P%d", k + 1);
            point->SetName(name);
            point->SetPosition(at[0] + k, at[1], at[2] * k);
            points->AddPointElement(point);
        }
        put(socket, points, "Marks", round);

        igtl::PolyDataMessage::Pointer surface = igtl::PolyDataMessage::New();
        igtl::PolyDataPointArray::Pointer corners = igtl::PolyDataPointArray::New();
        for (int k = 0; k < 4; k++) corners->AddPoint(at[0] + (k & 1), at[1] + (k >> 1), at[2] + k * k);
        igtl::PolyDataCellArray::Pointer faces = igtl::PolyDataCellArray::New();
        igtlUint32 triangles[4][3] = {{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};
        for (auto& face : triangles) faces->AddCell(3, face);
        surface->SetPoints(corners);
        surface->SetPolygons(faces);
        put(socket, surface, "Scan", round);

        // As the drivers of PLUS for depth cameras: a point image of 4 x 3 pixels, and its depth in steps of 0.1 mm.
        float spacing[3] = {1, 1, 1};
        igtl::Matrix4x4 still;
        igtl::IdentityMatrix(still);
        igtl::ImageMessage::Pointer cloud = igtl::ImageMessage::New();
        cloud->SetDimensions(4, 3, 1);
        cloud->SetSpacing(spacing);
        cloud->SetNumComponents(3);
        cloud->SetScalarType(igtl::ImageMessage::TYPE_FLOAT32);
        cloud->SetEndian(igtl::ImageMessage::ENDIAN_LITTLE);  // the library states the other
        cloud->AllocateScalars();
        igtl::ImageMessage::Pointer depth = igtl::ImageMessage::New();
        depth->SetDimensions(4, 3, 1);
        depth->SetSpacing(spacing);
        depth->SetScalarType(igtl::ImageMessage::TYPE_UINT16);
        depth->SetEndian(igtl::ImageMessage::ENDIAN_LITTLE);  // the library states the other
        depth->AllocateScalars();
        igtl::ImageMessage::Pointer grey = igtl::ImageMessage::New();
        grey->SetDimensions(4, 3, 1);
        grey->SetSpacing(spacing);
        grey->SetScalarType(igtl::ImageMessage::TYPE_UINT8);
        grey->SetEndian(igtl::ImageMessage::ENDIAN_LITTLE);  // the library states the other
        grey->AllocateScalars();
        for (int k = 0; k < 12; k++) {
            float z = 300.0f + round + k;
            float point[3] = {(k % 4 - 1.5f) * z / 500, (k / 4 - 1.0f) * z / 400, z};
            // The last pixel sees nothing.
            for (int c = 0; c < 3; c++) ((float*)cloud->GetScalarPointer())[3 * k + c] = k == 11 ? 0 : point[c];
            ((unsigned short*)depth->GetScalarPointer())[k] = k == 11 ? 0 : (unsigned short)(10 * (300 + round + k));
            ((unsigned char*)grey->GetScalarPointer())[k] = (unsigned char)(round + k);
        }
        for (auto& image : {cloud, depth, grey}) image->SetMatrix(still);
        put(socket, cloud, "VideoStreamPCL", round);
        put(socket, depth, "VideoStreamDEPTH", round);
        put(socket, grey, "VideoStreamIR", round);

        igtl::StringMessage::Pointer said = igtl::StringMessage::New();
        said->SetString("of the bone");
        put(socket, said, "Note", round);

        igtl::StatusMessage::Pointer status = igtl::StatusMessage::New();
        status->SetCode(1);
        status->SetErrorName("OK");
        status->SetStatusString("ready");
        put(socket, status, "State", round);
        igtl::Sleep(50);
    }
    socket->CloseSocket();
    return 0;
}

int main(int argc, char** argv) {
    if (argc == 5 && !std::strcmp(argv[1], "receive")) return receive(argv[2], std::atoi(argv[3]), std::atof(argv[4]));
    if (argc == 4 && !std::strcmp(argv[1], "send")) return send(std::atoi(argv[2]), (unsigned)std::atoi(argv[3]));
    return 2;
}
